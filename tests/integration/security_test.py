"""A robot with DDS Security, in a network namespace of its own beside another host: real processes
with the permissions that are shipped, and those who have none.

    security_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import json
import pathlib
import shutil
import struct
import subprocess
import signal
import sys
import time

import wire_test
from fleet import SOURCE, Fleet
from wire_test import USUAL, check, told, wait_told

SECURITY = SOURCE / "deploy/security"
TWIST = "geometry_msgs::msg::dds_::Twist_"
# What each process of the robot may be, and whose nodes it has.
ROBOT = {"/rips/sensor": ["sensor"], "/rips/actuator": ["actuator"], "/safety": ["manager"],
         "/drivers": ["node", "/camera", "/lidar"], "/base": ["node"], "/navigator": ["node"]}
# As nodes had it that were not kept from steering.
OPEN_DOOR = SECURITY / "permissions.manager.xml"


class Keystore:
    """One authority, minted by deploy/security/keystore."""

    def __init__(self, directory):
        self.dir = pathlib.Path(directory)
        self.script("init")

    def script(self, *args):
        subprocess.run([SECURITY / "keystore", "--dir", self.dir, *args], check=True,
                       stdout=subprocess.DEVNULL)

    def mint(self, enclave, *kind):
        """Gives the options with which a process joins as that enclave."""
        self.script("--renew", "enclave", enclave, *kind)
        return self.options(enclave)

    def options(self, enclave):
        return ("--keystore", self.dir, "--enclave", enclave)

    def file(self, enclave, name):
        return self.dir / "enclaves" / enclave.lstrip("/") / name

    def put(self, enclave, name, source):
        """In place of the file, which may be a link."""
        self.file(enclave, name).unlink()
        shutil.copyfile(source, self.file(enclave, name))

    def variant(self, kind, name, old, new):
        """A file of permissions that differs from a shipped one."""
        text = (SECURITY / f"permissions.{kind}.xml").read_text()
        check(old in text, f"permissions.{kind}.xml has no {old}")
        path = self.dir / f"{name}.xml"
        path.write_text(text.replace(old, new))
        return path


class SecuredFleet(Fleet):
    """All of it on the robot's host, and secured."""

    def __init__(self, world, **options):
        super().__init__(world.bin, world.dir / "fleet", floor_hold="1s", **options)
        self.within = ["ip", "netns", "exec", world.robot]
        self.domain, self.processes = world.domain, world.processes
        self.env["CYCLONEDDS_URI"] = f"<CycloneDDS><Domain>{USUAL}</Domain></CycloneDDS>"
        self.keys = Keystore(self.dir / "keystore")
        self.keystore = self.keys.dir
        for enclave, kind in ROBOT.items():
            self.keys.mint(enclave, *kind)
        # Somebody who may look at the modes.
        self.looker = self.keys.mint("/looker", "actuator")

    def up(self):
        return self.arm("--keystore", self.keystore)

    def order_modes(self, *args):
        """Runs robot_sim on the robot; gives (exit code, what it printed)."""
        done = subprocess.run([*self.within, self.bin / "robot_sim", args[0], "--domain",
                               str(self.domain), *args[1:]], capture_output=True, text=True,
                              timeout=60, env=self.env, check=False)
        return done.returncode, done.stdout + done.stderr

    def peer(self, name, *args):
        return self.start(name, self.bin / "dds_peer", "--domain", self.domain, *args)

    def modes(self):
        """What the robot was switched to, in order."""
        return [each["mode"] for each in self.robot.events() if each["event"] == "mode"]

    def check_mode(self, mode):
        have = self.mode(*self.looker)
        check(have["mode"] == mode, f"the robot is not in {mode}: {have}")
        return {part["part"]: part["state"] for part in have["parts"]}


def prefix_of(peer):
    return peer.wait_for(lambda line: line.split()[1] if line.startswith("up ") else None, 15,
                         f"{peer.name} is up")[1]


def wait_heard(peer, prefix, seconds=20):
    """Waits until it has heard that participant since now."""
    return peer.wait_for(lambda line: line.startswith("heard ") and f" {prefix}=" in line, seconds,
                         f"{peer.name} hears {prefix}", start=len(peer.lines))


def heard(peer):
    """Everybody it has ever heard."""
    return {part.split("=")[0] for _, text in peer.lines if text.startswith("heard ")
            for part in text.split()[1:]}


def graph_text(fleet):
    return fleet.ripsctl("robot", "graph", "r1")[1]


# ------------------------------------------------------------------------------------ scenarios


def secured_robot(world):
    """The sensor sees graph and messages, a rule raises the level, the actuator orders the mode, and
    all that is read back."""
    fleet = SecuredFleet(world)
    fleet.up()
    states = fleet.check_mode("__DEFAULT__")
    check(set(states.values()) == {"active"}, f"{states}")
    text = graph_text(fleet)
    check(all(node in text for node in ("/camera", "/lidar", "/base", "/navigator", "/safety")),
          f"nodes are missing: {text}")

    driver = fleet.start_intruder("rogue-cmd-vel", "--node", "/rogue",
                                  *fleet.keys.mint("/rogue", "node"))

    driver.wait_for(lambda line: '"event":"first_sample"' in line, 20, "the rogue drives")
    fleet.wait_level("COMPROMISED", 30)
    states = fleet.check_mode("COMPROMISED")
    check(states == {"/camera": "inactive", "/lidar": "active", "/base": "inactive",
                     "/navigator": "inactive"}, f"{states}")
    check(told(fleet, "somebody besides /navigator is driving"), f"{fleet.alerts()}")
    check(not told(fleet, "finding"), f"told without a reason: {told(fleet, 'finding')}")


def stranger_without_authentication(world):
    """A process of another host that has no certificate, and one whose certificate another
    authority made: both are told of, and their data reaches nobody."""
    fleet = SecuredFleet(world)
    listener = fleet.peer("listener", "--hear", f"rt/cmd_vel,{TWIST}",
                          *fleet.keys.mint("/listener", "node"))
    fleet.up()
    navigator = fleet.peer("second", "--node", "/navigator_2", "--publish",
                           f"rt/cmd_vel,{TWIST},reliable", *fleet.keys.mint("/navigator_2", "node"))
    wait_heard(listener, prefix_of(navigator))
    fleet.wait_level("COMPROMISED", 30)
    others = Keystore(world.dir / "others")

    def beside(name, *args):
        return world.start(name, world.other, world.bin / "dds_peer", "--domain", world.domain,
                           "--node", "/navigator", *args, xml=USUAL)

    def write(name, *args):
        return beside(name, "--publish", f"rt/cmd_vel,{TWIST},reliable", *args)

    friend = beside("friend", "--hear", f"rt/cmd_vel,{TWIST}")
    stranger = write("stranger")
    impostor = write("impostor", *others.mint("/navigator", "node"))

    wait_heard(friend, prefix_of(stranger))
    for each in (stranger, impostor):
        prefix = prefix_of(each)
        guid = ".".join(prefix[i:i + 8] for i in (0, 8, 16))
        wait_told(fleet, f"GUID {guid}.000001c1", 40)
        check("finding unauthenticated" in told(fleet, f"GUID {guid}")[0], f"{fleet.alerts()}")
    wait_heard(listener, prefix_of(navigator))
    check(not {prefix_of(stranger), prefix_of(impostor)} & heard(listener),
          f"data of a stranger arrived: {heard(listener)}")
    check(heard(friend) == {prefix_of(stranger)}, f"a stranger hears the robot: {heard(friend)}")
    check("/navigator_2" in graph_text(fleet), "the sensor sees the robot no more")


# What steers the robot or lies about it, apart from change_mode. By dds_peer's topics.
OTHER_DOORS = ["rq/camera/change_stateRequest", "rq/ns/camera/set_parametersRequest",
               "rq/camera/set_parameters_atomicallyRequest", "rr/safety/get_modeReply",
               "rr/camera/get_stateReply", "rr/camera/get_parametersReply", "rt/safety/mode_event"]


REQUEST = "rq/safety/change_modeRequest,system_modes_msgs::srv::dds_::ChangeMode_Request_"
REPLY = "rr/camera/get_stateReply,lifecycle_msgs::srv::dds_::GetState_Response_"
CHATTER = "rt/chatter,std_msgs::msg::dds_::String_"


def request(mode):
    """A request for change_mode as it is on the wire: CDR header, client, number, name."""
    name = mode.encode() + b"\0"
    return (b"\0\1\0\0" + struct.pack("<QqI", 1, 1, len(name)) + name).hex()


class Attack:
    """A node that heeds no permissions asks for HALT, answers for the camera, and talks, all the
    time; and those who listen."""

    def __init__(self, fleet, enclave):
        self.fleet = fleet
        listener = fleet.keys.mint("/listener", "node")
        self.listener = fleet.peer("listener", "--hear", CHATTER, *listener)
        self.looker = fleet.peer("looker", "--hear", f"{REPLY},reliable", *fleet.looker)
        self.attacker = fleet.peer("attacker", "--lawless", "--period-us", 1_000_000,
                                   "--payload", request("HALT"),
                                   *sum((("--publish", f"{topic},reliable")
                                         for topic in (REQUEST, REPLY, CHATTER)), ()), *enclave)
        self.prefix = prefix_of(self.attacker)
        wait_heard(self.listener, self.prefix)

    def answers(self):
        return self.prefix in heard(self.looker)


def nodes_cannot_steer(world):
    """An authenticated node with the permissions of any node asks for a mode: refused by its own
    middleware, and if that does not care by the manager's. The actuator is heard."""
    fleet = SecuredFleet(world)
    fleet.up()
    modes = len(fleet.modes())
    node = fleet.keys.mint("/intruder", "node")

    code, text = fleet.order_modes("set-mode", "--part", "/safety", "--mode", "HALT", *node)

    check(code == 1 and "Not Allowed By Security" in text, f"{code}: {text}")
    for topic in OTHER_DOORS:
        peer = fleet.peer("door", "--publish", f"{topic},t,reliable", *node)
        check(peer.child.wait(20) == 1, f"{topic} is open")
        peer.wait_for(lambda line: "Not Allowed By Security" in line, 5, f"{topic} is refused")
    # With its own, and with other people's services, it does as it likes.
    peer = fleet.peer("own", "--publish", "rr/intruder/get_stateReply,t,reliable", "--publish",
                      "rq/planner/planRequest,t,reliable", "--count", 1, *node)
    peer.wait_for(lambda line: line.startswith("sent rq/"), 20, "other services are open")

    # One that its own middleware lets do it, by permissions that it has signed itself.
    forger = Keystore(world.dir / "forger")
    forger.mint("/intruder", OPEN_DOOR)
    for name in ("permissions_ca.cert.pem", "governance.p7s", "permissions.p7s"):
        fleet.keys.put("/intruder", name, forger.file("/intruder", name))
    start = len(fleet.robot.lines)
    code, text = fleet.order_modes("set-mode", "--part", "/safety", "--mode", "HALT", *node)
    check(code == 1 and "no server for `/safety/change_mode`" in text and '"event":"set_mode"' not in text,
          f"{code}: {text}")
    fleet.robot.wait_for(lambda line: "Could not get remote participant" in line, 5,
                         "the robot refuses its permissions", start)

    # One that has seen to it that its own middleware asks for none.
    attack = Attack(fleet, fleet.keys.mint("/intruder", "node"))
    time.sleep(3)
    check(attack.attacker.running and not attack.answers(), "a false answer arrived")

    fleet.check_mode("__DEFAULT__")
    check(len(fleet.modes()) == modes, f"the mode was switched: {fleet.modes()}")
    fleet.ripsctl("level", "raise", "r1", "--to", "HALT", "--reason", "the actuator may")
    fleet.wait_level("HALT", 30)
    fleet.check_mode("HALT")


def nodes_can_steer_with_permissions_that_allow_it(world):
    """The same attack where the door stands open: the robot obeys, and the sensor tells of it."""
    fleet = SecuredFleet(world)
    fleet.up()

    code, text = fleet.order_modes("set-mode", "--part", "/safety", "--mode", "ALERT",
                                 *fleet.keys.mint("/intruder", OPEN_DOOR))

    check(code == 0 and '"success":true' in text, f"{code}: {text}")
    fleet.robot.wait_for(lambda line: '"event":"mode"' in line and '"ALERT"' in line, 15,
                         "the robot obeys")
    attack = Attack(fleet, fleet.keys.options("/intruder"))
    fleet.robot.wait_for(lambda line: '"event":"mode"' in line and '"HALT"' in line, 15,
                         "the robot obeys again")
    wait_heard(attack.looker, attack.prefix)
    check("topic /safety/change_mode" in wait_told(fleet, "finding foreign_mode_writer"),
          f"{fleet.alerts()}")
    time.sleep(12)  # longer than the lease of the first, which may have left before we knew it
    # All participants of an enclave begin alike.
    check(not told(fleet, f"finding unauthenticated, GUID {attack.prefix[:8]}"), f"{fleet.alerts()}")


def bad_identities(world):
    """Sensor and actuator do not join with files that are not theirs or no longer hold; they say
    which, and wait for others or end with 2."""
    fleet = SecuredFleet(world)
    fleet.port = 1
    fleet.prepare()
    others = Keystore(world.dir / "others")

    def refused(role, words):
        agent = fleet.start_agent(role, wait=False)
        agent.wait_for(lambda line: all(word in line for word in words), 20, f"{role} says {words}")
        time.sleep(0.2)
        check(agent.running or agent.child.returncode == 2, f"{role}: {agent.child.returncode}")
        agent.kill(signal.SIGKILL)

    for role in ("sensor", "actuator"):
        enclave = f"/rips/{role}"

        def mint(kind=role, store=fleet.keys):
            store.mint(enclave, kind)

        def file(name):
            return fleet.keys.file(enclave, name)

        mint(store=others)
        expire(fleet.keys, enclave)
        refused(role, [str(file("cert.pem")), "has expired"])
        mint(fleet.keys.variant(role, "old", "@NOT_AFTER@", "2020-01-01T00:00:00"))
        refused(role, [str(file("permissions.p7s")), "to 2020-01-01"])
        mint()
        fleet.keys.put(enclave, "identity_ca.cert.pem", others.file(enclave, "identity_ca.cert.pem"))
        refused(role, [str(file("cert.pem")), "is not vouched for by"])
        mint()
        fleet.keys.put(enclave, "permissions.p7s", others.file(enclave, "permissions.p7s"))
        refused(role, [str(file("permissions.p7s")), "is not signed by"])
        mint()
        fleet.keys.put(enclave, "key.pem", others.file(enclave, "key.pem"))
        refused(role, [str(file("key.pem")), "is not the key of"])
        mint()
        file("key.pem").unlink()
        refused(role, [str(file("key.pem")), "No such file"])


def expire(keys, enclave):
    """Its certificate ended yesterday; the key is the same."""
    private, public = keys.dir / "private", keys.dir / "public"
    csr = keys.dir / "csr"
    subprocess.run(["openssl", "req", "-new", "-key", keys.file(enclave, "key.pem"), "-subj",
                    "/CN=" + enclave.replace("/", "\\/"), "-out", csr], check=True)
    subprocess.run(["openssl", "x509", "-req", "-in", csr, "-CA", public / "identity_ca.cert.pem",
                    "-CAkey", private / "identity_ca.key.pem", "-set_serial", "7", "-days", "-1",
                    "-sha256", "-out", keys.file(enclave, "cert.pem")], check=True,
                   capture_output=True)


SCANS = """levels: DEFAULT; ALERT; COMPROMISED; HALT;
rules Msg:
  scans: topicin("/scan") && msgcount(1000000, 1000001, 1) ? trigger(HALT);
  odometry: topicin("/odom") && msgcount(1000000, 1000001, 1) ? trigger(COMPROMISED);
rules Graph:
  unused: false ? trigger(ALERT);
"""


def topic_that_is_hidden_from_the_sensor(world):
    """Permissions that keep one topic from the sensor: its coverage says so, and why."""
    fleet = SecuredFleet(world, bundle="scans")
    fleet.write("bundles/scans/manifest.yaml",
                "name: scans\nrules: [scans.rul]\nlevels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
    fleet.write("bundles/scans/scans.rul", SCANS)
    deny = ("<deny_rule><domains><id_range><min>0</min><max>230</max></id_range></domains>"
            "<subscribe><topics><topic>rt/scan</topic></topics></subscribe></deny_rule>\n"
            "      <allow_rule>")
    fleet.keys.mint("/rips/sensor", fleet.keys.variant("sensor", "blind", "<allow_rule>", deny))
    fleet.up()

    def publishers():
        code, text, _ = fleet.ripsctl("--output", "json", "robot", "coverage", "r1", check=False)
        return code, {each["name"]: (each["state"], each["why"])
                      for each in json.loads(text)["endpoints"] if each["kind"] == "publisher"}

    deadline = time.monotonic() + 30
    while publishers()[1].get("/scan", ("",))[0] != "not visible":
        check(time.monotonic() < deadline, f"nothing is missed: {publishers()}")
        time.sleep(0.2)
    code, states = publishers()
    check(code == 1, f"incomplete, and it ends with {code}")
    check("rt/scan" in states["/scan"][1] and "Not Allowed By Security" in states["/scan"][1],
          f"{states['/scan']}")
    check(states["/odom"] == ("watched", ""), f"{states['/odom']}")
    text = fleet.ripsctl("robot", "coverage", "r1", check=False)[1]
    check("not visible: creating topic `rt/scan`" in text, text)


wire_test.SCENARIOS = [secured_robot, stranger_without_authentication, nodes_cannot_steer,
                       nodes_can_steer_with_permissions_that_allow_it, bad_identities,
                       topic_that_is_hidden_from_the_sensor]

if __name__ == "__main__":
    sys.exit(wire_test.main())
