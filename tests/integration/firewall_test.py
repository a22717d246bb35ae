"""rips-fw on real DDS traffic: robot, intruder and policy server as network namespaces on a bridge.

    firewall_test.py BINARIES SCENARIO   runs one; without SCENARIO prints their names

Each namespace has a packet filter of its own: that of the host is not touched.
"""

import json
import os
import pathlib
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import Failed, Fleet, Process, Skipped, check, dds_uri, perform  # noqa: E402
from network import Network, missing, run  # noqa: E402
from protos import pb  # noqa: E402

CONTROL_PORT = 7443
HOSTS = {"robot": "10.77.0.1", "intruder": "10.77.0.2", "server": "10.77.0.3"}
TOPIC = "rt/peer,std_msgs::msg::dds_::String_"
LIMIT = 90  # seconds anything here may take on a busy machine
OK, INVALID, DENIED, PRECONDITION = 0, 3, 7, 9  # codes of absl::Status

RELEASE = {"kind": "FW_KIND_RELEASE"}

RULES = """# Nothing but what is always open, and the group by which nodes of one host find each other.
chain input {
  counter drop
}
chain output {
  ip daddr 239.255.0.1 counter accept
  counter drop
}
"""


def isolation(kind, target, seconds=600):
    return {"kind": f"FW_KIND_ISOLATE_{kind}", "targets": [target.encode()],
            "for_ms": seconds * 1000}


class World:
    """The namespaces, and what runs in them."""

    def __init__(self, binaries, directory):
        self.bin = pathlib.Path(binaries).resolve()
        self.dir = directory
        tag = f"ripsfw{random.getrandbits(32):08x}"
        self.network = Network(tag, HOSTS)
        self.domain = str(random.randint(10, 99))
        self.processes = []
        self.socket = self.dir / "fw.sock"
        self.env = dict(os.environ, CYCLONEDDS_URI=dds_uri("eth0", tag))

    def stop(self):
        for process in self.processes:
            if process.running:
                process.kill(signal.SIGKILL)
        self.network.remove()

    def start(self, host, name, *args, env=None):
        process = Process(name, [*self.network.within(host), *args], self.dir,
                          env or self.env)
        self.processes.append(process)
        return process

    def nft(self, *args, ok=True):
        return run(*self.network.within("robot"), "nft", *args, ok=ok)

    # -------------------------------------------------------------------------------- rips-fw

    def write_config(self):
        rules = self.dir / "alert.nft"
        rules.write_text(RULES)
        path = self.dir / "actuator.yaml"
        path.write_text(f"""robot: r1
host: base
servers: ["{HOSTS['server']}:{CONTROL_PORT}"]
tls: {{ca: /etc/ca.pem, cert: /etc/cert.pem, key: /etc/key.pem}}
dds: {{domain: 0, interface: lo}}
fail_safe: {{level: keep, after: 0s}}
firewall: {{socket: {self.socket}, user: "65534"}}
levels:
  - {{name: DEFAULT, enter: [{{firewall: {{release: all}}}}]}}
  - {{name: ALERT, enter: [{{firewall: {{file: {rules}}}}}]}}
""")
        return path

    def open_to_all(self):
        """rips-fw where each user may start it; the checkout may be below a directory of root's."""
        self.dir.chmod(0o755)
        return shutil.copy(self.bin / "rips-fw", self.dir)

    def start_fw(self, *before):
        ready = self.dir / "ready"
        ready.unlink(missing_ok=True)
        fw = self.start("robot", f"fw{len(self.processes)}", *before, self.bin / "rips-fw",
                        "--config", self.write_config(), "--ready-file", ready)
        fw.wait_for(lambda text: "listening" in text, LIMIT, "rips-fw listens")
        return fw

    def ask(self, verb, step):
        """(code, {field: text}) of the answer."""
        request = pb("FwRequest")(verb=f"FW_VERB_{verb}", **step)
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as asking:
            asking.settimeout(LIMIT)
            asking.connect(str(self.socket))
            asking.send(request.SerializeToString())
            answer = pb("FwResponse").FromString(asking.recv(65536))
        check(answer.HasField("code"), f"the answer is {answer}")
        self.dropped = answer.dropped if answer.HasField("dropped") else None
        return answer.code, {name: getattr(answer, name).decode()
                             for name in ("message", "observed", "note")}

    def drops(self, step):
        """Packets that the table has dropped on their way in."""
        code, fields = self.ask("CHECK", step)
        check(code == OK and self.dropped is not None, f"check says {code} {fields} {self.dropped}")
        return self.dropped

    def still_dropped(self, step):
        """More is dropped now than before."""
        before = self.drops(step)
        deadline = time.monotonic() + LIMIT
        while self.drops(step) <= before:
            check(time.monotonic() < deadline, f"no packet was dropped: {before} before")
            time.sleep(0.1)

    def enter(self, step):
        code, fields = self.ask("ENTER", step)
        check(code == OK, f"{step}: {code} {fields}")
        return fields

    def isolate_host(self, address, seconds=600):
        return self.enter(isolation("HOSTS", address, seconds))

    def rules_step(self):
        return {"kind": "FW_KIND_RULES", "file": os.fsencode(self.dir / "alert.nft"),
                "for_ms": 600_000}

    # -------------------------------------------------------------------------------- traffic

    def start_writer(self, host, name, options=""):
        """20 samples a second, reliable. Returns its GUID prefix, as 24 hexadecimal digits."""
        writer = self.start(host, name, self.bin / "dds_peer", "--domain", self.domain,
                            "--publish", f"{TOPIC},reliable{options}", "--period-us", 50_000)
        return writer.wait_for(lambda text: text.startswith("up ") and text.split()[1], LIMIT,
                               f"{name} is ready")[1]

    def start_reader(self, options=""):
        self.reader = self.start("robot", "reader", self.bin / "dds_peer", "--domain", self.domain,
                                 "--hear", f"{TOPIC}{options}")

    def seen(self, found, what):
        """Waits until found(former, now) is true of two reports ten apart; the later one.

        A report is {GUID prefix: (samples, the newest's number)}.
        """
        reports = []

        def look(text):
            if not text.startswith("heard"):
                return False
            counts = (word.split("=") for word in text.split()[1:])
            reports.append({prefix: tuple(map(int, count.split("/"))) for prefix, count in counts})
            return len(reports) > 10 and found(reports[-11], reports[-1])

        self.reader.wait_for(look, LIMIT, what, start=len(self.reader.lines))
        return reports[-1]

    def flows(self, on, off=()):
        """Waits until all of `on` are heard, and none of `off`, for two seconds."""
        def count(report, prefix):
            return report.get(prefix, (0, 0))[0]

        return self.seen(
            lambda former, now: all(count(now, p) >= count(former, p) + 5 for p in on)
            and all(count(now, p) == count(former, p) for p in off),
            f"{on} are heard and {off} are not")

    def start_control(self):
        """A TCP connection between robot and server, as the actuator's stream is one."""
        echo = self.start("server", "echo", sys.executable, "-B", __file__, "--echo",
                          HOSTS["server"])
        echo.wait_for(lambda text: text == "listening", LIMIT, "the server listens")
        return self.start_pings("control")

    def start_pings(self, name):
        pings = self.start("robot", name, sys.executable, "-B", __file__, "--ping", HOSTS["server"])
        pings.wait_for(lambda text: text.startswith("pong"), LIMIT, f"{name} is up")
        return pings

    def control_lives(self, pings):
        """Ten messages there and back, from now on, on the same connection."""
        begin = len(pings.lines)
        last = int(pings.lines[-1][1].split()[1])
        pings.wait_for(lambda text: text == f"pong {last + 10}", LIMIT, "the control channel lives",
                       start=begin)


def echo(address):
    def serve(peer):
        while data := peer.recv(100):
            peer.sendall(data)

    listener = socket.create_server((address, CONTROL_PORT))
    print("listening", flush=True)
    while True:
        threading.Thread(target=serve, args=[listener.accept()[0]], daemon=True).start()


def knock(address):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
        while True:
            sending.sendto(b"knock", (address, 7400))
            time.sleep(0.05)


def ping(address):
    with socket.create_connection((address, CONTROL_PORT), timeout=LIMIT) as peer:
        for number in range(1_000_000):
            peer.sendall(b"x")
            check(peer.recv(1) == b"x", "closed")
            print("pong", number, flush=True)
            time.sleep(0.05)


# ------------------------------------------------------------------------------------ scenarios

def one_participant_is_isolated(world):
    bad = world.start_writer("intruder", "bad")
    neighbour = world.start_writer("intruder", "neighbour")
    world.start_reader()
    world.start_fw()
    control = world.start_control()
    world.flows([bad, neighbour])

    world.enter(isolation("PARTICIPANTS", bad))

    world.flows([neighbour], [bad])
    world.control_lives(control)
    world.still_dropped(isolation("PARTICIPANTS", bad))


def one_host_is_isolated_until_its_time_is_over(world):
    bad = world.start_writer("intruder", "bad")
    own = world.start_writer("robot", "own")
    world.start_reader()
    world.start_fw()
    control = world.start_control()
    world.flows([bad, own])

    world.isolate_host(HOSTS["intruder"], 12)
    world.still_dropped(isolation("HOSTS", HOSTS["intruder"], 12))

    world.flows([own], [bad])
    world.control_lives(control)
    for target in (HOSTS["server"], HOSTS["robot"]):
        code, fields = world.ask("ENTER", isolation("HOSTS", target))
        check(code == INVALID and "never isolated" in fields["message"], f"{code} {fields}")
    # Nobody renews it: the kernel ends it, and discovery finds the writer again.
    world.flows([bad, own])
    code, fields = world.ask("CHECK", isolation("HOSTS", HOSTS["intruder"], 12))
    check(code == PRECONDITION and "no longer isolated" in fields["message"], f"{code} {fields}")


def a_level_that_drops_everything_keeps_the_server(world):
    bad = world.start_writer("intruder", "bad")
    own = world.start_writer("robot", "own")
    world.start_reader()
    fw = world.start_fw()
    control = world.start_control()
    world.flows([bad, own])

    world.enter(world.rules_step())
    world.flows([own], [bad])
    world.still_dropped(world.rules_step())
    world.control_lives(control)
    world.control_lives(world.start_pings("new-control"))

    # The administrator deletes the table: told, and mended.
    world.nft("delete", "table", "inet", "rips")
    code, fields = world.ask("CHECK", world.rules_step())
    check(code == PRECONDITION and "was deleted" in fields["message"], f"{code} {fields}")
    world.flows([bad, own])
    world.enter(world.rules_step())
    world.flows([own], [bad])

    # rips-fw dies: the kernel holds on; the next one says that it does not know, and mends.
    fw.kill(signal.SIGKILL)
    world.flows([own], [bad])
    world.start_fw()
    code, fields = world.ask("CHECK", world.rules_step())
    check(code == PRECONDITION and "started anew" in fields["message"], f"{code} {fields}")
    world.enter(world.rules_step())
    code, fields = world.ask("CHECK", world.rules_step())
    check(code == OK, f"check says {fields}")
    world.flows([own], [bad])
    world.control_lives(control)

    world.enter(RELEASE)
    world.flows([bad, own])


def a_release_holds_until_the_lease_has_ended(world):
    bad = world.start_writer("intruder", "bad", ",keep_all")
    own = world.start_writer("robot", "own")
    world.start_reader(",reliable")
    world.start_fw()
    world.flows([bad, own])

    world.isolate_host(HOSTS["intruder"])
    before = world.flows([own], [bad])
    fields = world.enter(RELEASE)
    check(f"until their leases have ended: {HOSTS['intruder']} in" in fields["note"],
          f"not held: {fields}")
    check("have kept for us comes at once" in fields["note"], f"not told: {fields}")
    world.flows([own], [bad])
    after = world.flows([bad, own])
    # The intruder went on hearing our multicast: what the note says comes true.
    samples, written = (now - then for now, then in zip(after[bad], before[bad]))
    print(f"{samples} samples came of the {written} that were written meanwhile")


def capability_and_socket_from_outside(world):
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(str(world.socket))
    listener.listen(8)
    os.chmod(world.socket, 0o666)
    rips_fw = world.open_to_all()
    os.set_inheritable(listener.fileno(), True)
    shell = f"exec 3<&{listener.fileno()}; export LISTEN_PID=$$ LISTEN_FDS=1; exec \"$@\""
    config = world.write_config()
    child = subprocess.Popen(
        [*world.network.within("robot"), "setpriv", "--reuid=65534", "--regid=65534",
         "--clear-groups", "--inh-caps=-all,+net_admin", "--ambient-caps=-all,+net_admin",
         "--bounding-set=-all,+net_admin", "--no-new-privs",
         "sh", "-c", shell, "sh", rips_fw, "--config", str(config)],
        pass_fds=[listener.fileno()], stdin=subprocess.DEVNULL)
    try:
        check(world.enter(world.rules_step())["observed"] == "firewall=alert.nft", "not entered")
        check("rips 1" in world.nft("list", "table", "inet", "rips").stdout, "no rule in the kernel")
        # Another user is refused, although the socket's mode lets it in.
        refused = run("setpriv", "--reuid=65533", "--clear-groups", sys.executable, "-B", "-c",
                      "import socket, sys; s = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)\n"
                      "s.connect(sys.argv[1]); print(s.recv(1000).hex())", world.socket)
        answer = pb("FwResponse").FromString(bytes.fromhex(refused.stdout))
        check(answer.code == DENIED and b"user 65533 may not ask" in answer.message,
              f"{answer} {refused.stderr}")
    finally:
        child.terminate()
        check(child.wait(LIMIT) == 0, f"ended with {child.returncode}")
        listener.close()


def what_is_missing_is_told_at_the_start(world):
    config = world.write_config()
    fw = [world.open_to_all(), "--config", config]
    inside = world.network.within("robot")
    without = run(*inside, "setpriv", "--reuid=65534", "--clear-groups", "--bounding-set=-all", *fw,
                  ok=False)
    check(without.returncode != 0 and "not permitted" in without.stderr,
          f"{without.returncode} {without.stderr}")
    for text, why in [("chain input {\n frob\n}\n", "syntax error"),
                      ("chain input {\n drop; flush ruleset\n}\n", "alert.nft:2: a rule cannot"),
                      ("table inet other {\n}\n", "alert.nft:1:")]:
        (world.dir / "alert.nft").write_text(text)
        bad = run(*inside, *fw, ok=False)
        check(bad.returncode == 2 and why in bad.stderr, f"{bad.returncode} {bad.stderr}")
    (world.dir / "alert.nft").unlink()
    gone = run(*inside, *fw, "--check-config", ok=False)
    check(gone.returncode == 2 and "No such file" in gone.stderr, f"{gone.stderr}")
    line = next(number for number, text in enumerate(config.read_text().splitlines(), 1)
                if "alert.nft" in text)
    check(f"{config}:{line}: cannot read" in gone.stderr, f"not where: {gone.stderr}")
    check("table" not in world.nft("list", "ruleset").stdout, "something was loaded")


def levels_with_a_firewall(world):
    """The whole of RIPS inside the robot's namespace, whose loopback it uses."""
    directory = world.dir / "fleet"
    world.start("intruder", "knocks", sys.executable, "-B", __file__, "--knock", HOSTS["robot"])
    inside = world.start("robot", "fleet", sys.executable, "-B", __file__, world.bin,
                         "levels_with_a_firewall", directory)
    try:
        inside.wait_for(lambda text: text == "passed", 4 * LIMIT, "the robot's part")
    finally:
        inside.kill()


class FirewalledFleet(Fleet):
    """ALERT and above drop everything but loopback and the server; DEFAULT releases."""

    STEPS = {"DEFAULT": "{release: all}", "ALERT": "{file: RULES}", "COMPROMISED": "{file: RULES}"}

    def write_agent_configs(self):
        super().write_agent_configs()
        rules = self.write("alert.nft", RULES)
        path = self.dir / "actuator.yaml"
        text = path.read_text() + f"firewall: {{socket: {self.dir}/fw.sock, user: \"0\"}}\n"
        for level, step in self.STEPS.items():
            text = text.replace(f"  - name: {level}\n    enter:\n", f"  - name: {level}\n    enter:\n"
                                f"      - {{firewall: {step.replace('RULES', str(rules))}}}\n")
        path.write_text(text)

    def start_fw(self):
        fw = self.start(f"fw{len(self.processes)}", self.bin / "rips-fw", "--config",
                        self.dir / "actuator.yaml")
        fw.wait_for(lambda text: "listening" in text, LIMIT, "rips-fw listens")
        return fw

    def until(self, found, what):
        deadline = time.monotonic() + LIMIT
        while not found():
            check(time.monotonic() < deadline, f"{what}: not within {LIMIT} s")
            time.sleep(0.1)

    def held(self):
        """Whether the level's rules are in force in the kernel."""
        listed = run("nft", "list", "table", "inet", "rips", ok=False).stdout
        return "ipv4 timeout" in listed and "rips 1" in listed

    def told(self, text, start):
        self.actuator.wait_for(lambda line: text in line, LIMIT, f"`{text}` is told", start=start)


def play_inside(fleet):
    fleet.prepare()
    fleet.start_robot()
    fleet.start_server()
    fleet.write_agent_configs()
    fw = fleet.start_fw()
    fleet.start_agent("sensor")
    fleet.actuator = fleet.start_agent("actuator")
    fleet.wait_level("DEFAULT", LIMIT)
    check(not fleet.held(), "DEFAULT has not released")

    fleet.ripsctl("level", "raise", "r1", "--to", "ALERT", "--reason", "test")
    fleet.wait_level("ALERT", LIMIT)
    check(fleet.held(), "verified without the rules")

    start = len(fleet.actuator.lines)
    run("nft", "delete", "table", "inet", "rips")
    fleet.until(fleet.held, "the deleted table is loaded again")
    fleet.told("table `inet rips` was deleted", start)
    fleet.wait_level("ALERT", LIMIT)

    # Without rips-fw a level with rules is not reached, and says why.
    start = len(fleet.actuator.lines)
    fw.kill(signal.SIGKILL)
    fleet.told("cannot reach rips-fw", start)
    check(fleet.held(), "the kernel has let go")
    fleet.ripsctl("level", "raise", "r1", "--to", "COMPROMISED", "--reason", "test")
    fleet.wait_level("COMPROMISED", LIMIT, stage="failed")
    fleet.start_fw()
    fleet.until(lambda: fleet.level()["effective_level"] == "COMPROMISED"
                and not fleet.level()["degraded"], "the level is reached after all")

    # An operator sees that what is kept out still sends.
    def shown():
        firewalls = json.loads(fleet.ripsctl("level", "show", "r1", "--output", "json")[1])
        return firewalls["firewalls"][0]
    fleet.until(lambda: (shown()["dropped_packets"] or 0) > 10, "what is dropped is counted")
    check(shown()["steps"][0].startswith("firewall /") and shown()["quiet_s"] < 10, f"{shown()}")
    sources = {each["address"]: each for each in shown()["sources"]}
    knocking = sources.get(HOSTS["intruder"])
    check(knocking and knocking["packets"] > 0 and knocking["quiet_s"] < 10
          and not knocking["agents"], f"{sources}")
    text = fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--dry-run")[1]
    check("something that it keeps out still sends" in text
          and f"from {HOSTS['intruder']}: " in text, text)

    fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--reason", "test")
    fleet.wait_level("DEFAULT", LIMIT)
    check(not fleet.held(), "DEFAULT has not released")


SCENARIOS = [levels_with_a_firewall, one_participant_is_isolated, one_host_is_isolated_until_its_time_is_over,
             a_level_that_drops_everything_keeps_the_server,
             a_release_holds_until_the_lease_has_ended, capability_and_socket_from_outside,
             what_is_missing_is_told_at_the_start]


def play(scenario, world):
    lacks = missing()
    if lacks is not None:
        raise Skipped(lacks)
    world.network.build()
    scenario(world)


def inside(binaries, directory):
    fleet = FirewalledFleet(binaries, directory, floor_hold="1s")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    try:
        play_inside(fleet)
    except Failed as failed:
        for process in fleet.processes:
            print(f"--- {process.name}")
            print("\n".join(text for _, text in process.lines[-12:]))
        print(f"FAILED inside: {failed}", flush=True)
        return 1
    finally:
        fleet.stop()
    print("passed", flush=True)
    return 0


def main():
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    plays = {"--echo": echo, "--knock": knock, "--ping": ping}
    if sys.argv[1] in plays:
        return plays[sys.argv[1]](sys.argv[2])
    if len(sys.argv) > 3:
        return inside(sys.argv[1], sys.argv[3])
    scenario = next(each for each in SCENARIOS if each.__name__ == sys.argv[2])
    # A short path: a Unix socket's may have 107 bytes.
    directory = pathlib.Path(tempfile.mkdtemp(prefix="rips-firewall-"))
    # So that the namespaces are removed then, too.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    code = perform(scenario.__name__, lambda world: play(scenario, world),
                   World(sys.argv[1], directory), tail=80)
    shutil.rmtree(directory)
    return code


if __name__ == "__main__":
    sys.exit(main())
