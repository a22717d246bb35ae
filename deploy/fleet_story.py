"""The demo on several hosts: five robots, of which one has two hosts, a policy server, an operator
and an attacker. Each host is a network namespace of this machine."""

import os
import pathlib
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests/support"))
from fleet import Failed, Fleet, check, eventually  # noqa: E402
from network import Network, missing, run  # noqa: E402
from story import Story, end_on_signals, options_of, say, tell, title  # noqa: E402

SKIPPED = 77
PORT = 7443
SERVER = "10.77.0.1"
HOSTS = {"server": SERVER, "operator": "10.77.0.2", "attacker": "10.77.0.3",
         "r1": "10.77.0.11", "r2": "10.77.0.12", "r3": "10.77.0.13", "r4": "10.77.0.14",
         "r5a": "10.77.0.15", "r5b": "10.77.0.16"}
# Robot to its hosts. The first has sensor and actuator, and the robot's primary sensor.
ROBOTS = {"r1": ["r1"], "r2": ["r2"], "r3": ["r3"], "r4": ["r4"], "r5": ["r5a", "r5b"]}
VICTIM = "r2"
PATIENCE = 60  # seconds for what takes one or two on an idle machine
FLOOR_HOLD = "3s"


class Host(Fleet):
    """One host of the network. Its DDS is configured as robots' is: by the interface's name."""

    address = SERVER
    interface = "eth0"

    def __init__(self, site, name, directory, **options):
        super().__init__(site.bin, directory, **options)
        self.site = site
        self.name = name
        self.port = PORT
        self.within = site.network.within(name)
        self.env.pop("CYCLONEDDS_URI")


class ServerHost(Host):
    """It issues the agents' certificates."""

    def prepare(self):
        self.mint("init")
        self.mint("server", "ps1")
        for role, name in (("admin", "root"), ("operator", "alice"), ("viewer", "bob")):
            self.mint("operator", role, name)
        (self.dir / "server").mkdir()
        self.write("robots.yaml", "robots:\n" + "".join(
            f"  - {{id: {robot}, bundle: {self.bundle}, actuators: [{hosts[0]}], sensors: ["
            + ", ".join(f"{{host: {host}, primary: {str(host == hosts[0]).lower()}}}"
                        for host in hosts) + "]}\n"
            for robot, hosts in ROBOTS.items()))

    def write_server_config(self, port):
        super().write_server_config(port)
        with open(self.dir / "policy-server.yaml", "a", encoding="utf-8") as config:
            config.write(f"enrolment: {{cert: {self.dir}/pki/ca/issuing.pem, "
                         f"key: {self.dir}/pki/ca/issuing.key, life: 24h}}\n")


class RobotHost(Host):
    """A host of robot `robot`, with its agents. Questions about the robot go to the server, from
    the operator's host."""

    def __init__(self, site, robot, name):
        super().__init__(site, name, site.dir / name, floor_hold=FLOOR_HOLD)
        self.robot_id, self.host_name = robot, name
        self.hosts = ROBOTS[robot]
        self.domain = 20 + list(ROBOTS).index(robot)
        self.roles = ("sensor", "actuator") if name == self.hosts[0] else ("sensor",)
        for folder in (*self.roles, "pki"):
            (self.dir / folder).mkdir()
        rules = self.write("isolate.nft", self.rules())
        isolate = f"{{firewall: {{file: {rules}}}}}"
        self.steps = {"DEFAULT": ["{firewall: {release: all}}"], "COMPROMISED": [isolate],
                      "HALT": [isolate]}
        if len(self.hosts) > 1:  # a manager would know only the nodes of its own host
            self.mode_options = ", backend: direct"

    def rules(self):
        """Nothing but the robot's own hosts, and the group by which its nodes find each other;
        rips-fw itself lets the server through."""
        others = [HOSTS[host] for host in self.hosts if host != self.name]
        return ("chain input {\n" + "".join(f"  ip saddr {each} accept\n" for each in others)
                + "  counter drop\n}\nchain output {\n"
                + "".join(f"  ip daddr {each} accept\n" for each in [*others, "239.255.0.1"])
                + "  counter drop\n}\n")

    def tls(self, *path):
        directory = self.dir / "pki" / path[0]
        return f"{{ca: {directory}/ca.pem, cert: {directory}/cert.pem, key: {directory}/key.pem}}"

    def write_agent_configs(self):
        super().write_agent_configs()
        with open(self.dir / "actuator.yaml", "a", encoding="utf-8") as config:
            config.write(f"firewall: {{socket: {self.dir}/fw.sock, user: \"{os.geteuid()}\"}}\n")

    def ripsctl(self, *args, **options):
        return self.site.operator.ripsctl(*args, **options)

    def enrol(self, *args):
        done = self.rips_enrol(self.dir / "pki", *args)
        check(done.returncode == 0, f"rips-enrol on {self.name}: {done.stdout}{done.stderr}")

    def serials(self):
        """Role to the serial number of the certificate that is here."""
        def serial(role):
            out = run("openssl", "x509", "-noout", "-serial", "-in",
                      self.dir / "pki" / role / "cert.pem").stdout
            return out.partition("=")[2].strip().lower().lstrip("0")
        return {role: serial(role) for role in self.roles}

    def start_nodes(self):
        if len(self.hosts) == 1:
            return self.start_robot()
        if self.name == self.hosts[0]:
            return self.start_robot("--manager", "absent", "--only", "/base", "/lidar",
                                    "/navigator")
        return self.start_robot("--manager", "absent", "--only", "/camera")

    def start_agents(self):
        """Without waiting until they are there; of the actuator's helper, until it listens."""
        self.write_agent_configs()
        self.agents = {}
        if "actuator" in self.roles:
            fw = self.start("fw", self.bin / "rips-fw", "--config", self.dir / "actuator.yaml")
            fw.wait_for(lambda line: "listening" in line, PATIENCE, "rips-fw listens")
        for role in self.roles:
            self.agents[role] = self.start_agent(role, wait=False)
        self.actuator = self.agents.get("actuator")

    def start_intruder(self, mode, *options):
        attacker = self.site.attacker
        attacker.domain = self.domain
        return attacker.start_intruder(mode, *options)

    def dropped(self):
        """Packets that this host's level has refused, of other hosts."""
        listed = run(*self.within, "nft", "list", "table", "inet", "rips").stdout
        counts = [line.split("packets ")[1].split()[0] for line in listed.splitlines()
                  if "counter packets" in line and "drop" in line]
        return sum(map(int, counts))


class Site:
    """All hosts, and the story of them."""

    def __init__(self, options):
        self.bin = pathlib.Path(options.binaries).resolve()
        self.dir = options.directory.resolve()
        self.network = Network(f"rips{os.getpid()}", HOSTS)
        self.server = ServerHost(self, "server", self.dir)
        self.operator = Host(self, "operator", self.dir)
        self.attacker = Host(self, "attacker", self.dir)
        self.hosts = {host: RobotHost(self, robot, host)
                      for robot, hosts in ROBOTS.items() for host in hosts}
        self.stories = {robot: Story(self.hosts[hosts[0]], f"{robot}: ", patience=4)
                        for robot, hosts in ROBOTS.items()}
        self.started = time.monotonic()

    def stop(self):
        everything = [self.attacker, *self.hosts.values(), self.server]
        for process in (each for host in everything for each in host.processes):
            if process.running:
                process.child.terminate()
        for host in everything:
            host.stop()
        self.network.remove()
        left = self.network.left()
        if left:
            print(f"warning: still there: {', '.join(left)}", file=sys.stderr)

    # ------------------------------------------------------------------------- what is seen

    def status(self):
        """Robot to its status, of all in one question."""
        return {each["robot"]: each
                for each in self.operator.query("robot", "list", who="viewer/bob")["robots"]}

    def wait_levels(self, wanted):
        """Waits until each robot is held and verified at its level."""
        def at(status, level):
            return (status["decided_level"], status["effective_level"], status["stage"],
                    status["degraded"]) == (level, level, "verified", [])

        def reached():
            now = self.status()
            return len(now) == len(ROBOTS) and all(
                at(now[robot], level) for robot, level in wanted.items()) and now

        try:
            return eventually(reached, PATIENCE, "every robot is at its level")
        except Failed as failed:
            raise Failed(f"{failed}; {list(self.status().values())}") from None

    def serials(self):
        """URI of each agent to the serial number of its certificate on its host."""
        return {f"spiffe://fleet.example/robot/{host.robot_id}/{role}/{name}": serial
                for name, host in self.hosts.items() for role, serial in host.serials().items()}

    def connected(self):
        """The same, as the server has seen them."""
        agents = self.operator.query("agent", "list")["agents"]
        return {each["uri"]: each["serial"] for each in agents if "/robot/" in each["uri"]}

    def check_untouched(self, robots):
        """Since they came to DEFAULT there was neither a decision nor an alert of a rule."""
        now = self.status()
        for robot in robots:
            check(now[robot]["decision_id"] == self.before[robot]["decision_id"],
                  f"{robot} has another decision: {now[robot]}")
            alerts = [each for each in self.stories[robot].fleet.alerts()
                      if each["rule"] != "(rips)"]
            check(not alerts, f"{robot} has alerts: {alerts}")

    # ----------------------------------------------------------------------------- the story

    def build(self):
        title("1. A network of its own")
        self.network.build()
        say("rips", f"{len(HOSTS)} hosts on a bridge, none with a way out: "
                    + ", ".join(f"{host} {address}" for host, address in HOSTS.items()))
        self.server.prepare()
        self.server.process = self.server.start_server()
        say("rips", f"policy server on {SERVER}:{PORT}, mutual TLS; it issues certificates; "
                    "operators: admin root, operator alice, viewer bob")

    def enrol(self):
        title("2. Each robot gets its certificates by a token")
        code, _, error = self.operator.ripsctl("enrol", "create-token", "r1", "r1", check=False)
        check(code == 1 and "needs the role `admin`" in error, f"an operator may: {error}")
        say("operator", "alice may not make tokens: that needs the role `admin`")
        for name, host in self.hosts.items():
            token = self.dir / f"{name}.token"
            self.operator.ripsctl("enrol", "create-token", host.robot_id, name, "--address",
                                  f"{SERVER}:{PORT}", "--out", token, who="admin/root")
            host.enrol("fetch", "--token", token)
            say("robot", f"{host.robot_id}: $ rips-enrol fetch --token {name}.token   (on {name}: "
                         f"certificates of {' and '.join(host.roles)})")

    def normal(self):
        title("3. Normal operation")
        for host in self.hosts.values():
            host.start_nodes()
        for host in self.hosts.values():
            host.start_agents()
        for robot in (VICTIM, "r5"):
            host = self.hosts[ROBOTS[robot][0]]
            self.stories[robot].camera = host.start_camera_probe()
        say("robot", "r1 to r4 have one host; of r5, /camera is on r5b, the other nodes on r5a")
        self.before = self.wait_levels({robot: "DEFAULT" for robot in ROBOTS})
        for story in self.stories.values():
            story.new_alerts()
        say("rips", f"{len(ROBOTS)} robots at DEFAULT, verified; what was told so far: "
                    "tokens used, actuators without a state")
        self.stories["r5"].camera_hz(lambda rate: rate > 8, 15)
        say("robot", "r5: the pictures of r5b come to r5a over the bridge")

    def attack(self):
        title(f"4. The attacker's host joins the DDS domain of {VICTIM}")
        story = self.stories[VICTIM]
        story.join()
        story.drive()

    def isolate(self):
        title(f"5. {VICTIM} is isolated, the others go on")
        story, host = self.stories[VICTIM], self.hosts[VICTIM]
        first = eventually(host.dropped, PATIENCE, "packets of the attacker are dropped")
        eventually(lambda: host.dropped() > first, PATIENCE, "and more of them")

        def forgotten():
            nodes = [each["name"] for each in host.query("robot", "graph", VICTIM)["nodes"]]
            return not any("intruder" in name for name in nodes)

        eventually(forgotten, PATIENCE, "the attacker's nodes leave the graph", 0.5)
        check(story.spy.running and story.driver.running, "the attacker has ended")
        say("rips", f"{VICTIM}: the firewall has dropped {host.dropped()} packets; the attacker "
                    "still sends, and is no longer part of the graph")
        story.tell_alerts()
        others = [robot for robot in ROBOTS if robot != VICTIM]
        self.check_untouched(others)
        say("rips", f"{', '.join(others)}: level DEFAULT, no alert of a rule, no decision")

    def release(self):
        title("6. The operator removes the attacker and brings the robot back")
        story = self.stories[VICTIM]
        story.driver.kill()
        story.spy.kill()
        say("attack", "the attacker is switched off")
        code, _, error = self.operator.ripsctl("level", "lower", VICTIM, "--to", "DEFAULT",
                                               "--reason", "try", check=False, who="viewer/bob")
        check(code == 1 and "role" in error, f"a viewer may lower a level: {error}")
        say("operator", f"bob may not lower it: {error.strip().splitlines()[-1]}")
        story.order("lower", "DEFAULT", "attacker found and removed, robot checked on site")
        story.tell_robot("DEFAULT", camera_on=True)

    def renew(self):
        title("7. Certificates are renewed while the streams stay up")
        before = self.serials()
        marks = [(agent, len(agent.lines)) for host in self.hosts.values()
                 for agent in host.agents.values()]
        for name, host in self.hosts.items():
            eventually(lambda: host.rips_enrol(host.dir / "pki", "renew", "--now").returncode == 0,
                       PATIENCE, f"the certificates of {name} are renewed")
        after = self.serials()
        kept = [uri for uri, serial in after.items() if serial == before[uri]]
        check(not kept, f"not renewed: {kept}")
        say("robot", f"$ rips-enrol renew --now   (on each host: {len(after)} certificates, all "
                     "new)")
        story = self.stories["r5"]
        story.order("raise", "COMPROMISED", "to be looked at")
        story.camera_hz(lambda rate: rate == 0, 15)
        say("robot", "r5: /camera on r5b is off, ordered and read back by r5a over the bridge")
        for agent, mark in marks:
            lost = [line for _, line in agent.lines[mark:] if "disconnected" in line]
            check(not lost, f"{agent.name}: {lost}")
        say("rips", "no stream has ended; orders come as before")

    def restart(self):
        title("8. The server is killed and comes back")
        story = self.stories["r5"]
        levels = {robot: "COMPROMISED" if robot == "r5" else "DEFAULT" for robot in ROBOTS}
        before = self.wait_levels(levels)
        self.server.process.kill(9)
        say("rips", "policy server killed (SIGKILL)")
        self.server.process = self.server.start_server()
        now = self.wait_levels(levels)
        for robot in ROBOTS:
            check(now[robot]["decision_id"] == before[robot]["decision_id"],
                  f"{robot} has another decision: {before[robot]} {now[robot]}")
        say("rips", "started again; robots at "
                    + ", ".join(f"{robot} {level}" for robot, level in levels.items())
                    + ", by the decisions they had")
        eventually(lambda: self.connected() == self.serials(), PATIENCE,
                   "all connect with renewed certificates")
        say("rips", "every agent has connected with its renewed certificate")
        story.order("lower", "DEFAULT", "looked at")
        story.camera_hz(lambda rate: rate > 8, 15)
        self.check_untouched(robot for robot in ROBOTS if robot not in (VICTIM, "r5"))

    def summary(self):
        title("What it took")
        self.stories[VICTIM].tell_latencies()
        print(f"  {len(self.serials())} agents on {len(self.hosts)} hosts; "
              f"{time.monotonic() - self.started:.0f} s")


def keep(site):
    operator, ctl = " ".join(site.operator.within), " ".join(site.operator.ripsctl_args()[4:])
    victim = site.hosts[VICTIM]
    print(f"""
Left running. In another terminal, as root:

  alias on-operator='{operator} {ctl}'
  on-operator robot list
  on-operator alert watch
  on-operator level raise r4 --to HALT --reason "trying it"
  on-operator level lower r4 --to DEFAULT --reason "tried it" --wait
  {' '.join(site.network.within("attacker"))} {' '.join(map(str, victim.robot_sim("intruder")))} \\
      --mode rogue-cmd-vel
  {' '.join(victim.within)} nft list table inet rips

Ctrl-C here stops everything and removes the hosts.""", flush=True)
    while True:
        time.sleep(1)


def main():
    end_on_signals()
    lacks = missing()
    if lacks is not None:
        print(f"skipped: {lacks}")
        return SKIPPED
    if sys.argv[1:] == ["--check"]:
        return 0
    options = options_of(__doc__)
    site = Site(options)
    return tell((site.build, site.enrol, site.normal, site.attack, site.isolate, site.release,
                 site.renew, site.restart, site.summary), options, site, keep)


if __name__ == "__main__":
    sys.exit(main())
