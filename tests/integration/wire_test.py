"""Attacks on a DDS domain that discovery does not show, in network namespaces of their own: a robot,
and another host on its network. Real processes: rips-sensor, rips-wire, DDS participants.

    wire_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import os
import pathlib
import random
import shlex
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import SOURCE, Failed, Fleet, Process, check, perform  # noqa: E402
from network import need_namespaces  # noqa: E402

ROBOT = "10.77.0.1"
OTHER = "10.77.0.9"
VICTIM_INDEX = 3
SENSOR_INDEX = 4


def fields(line):
    """The key=value fields of a log line."""
    return dict(part.split("=", 1) for part in shlex.split(line) if "=" in part)


class World:
    """Two hosts with a wire between them. `robot` and `other` are network namespaces; in both the
    interface is eth0."""

    def __init__(self, binaries, directory):
        self.bin = pathlib.Path(binaries).resolve()
        self.dir = pathlib.Path(directory).resolve()
        self.domain = random.randint(10, 99)
        self.socket = f"{self.dir}/wire.sock"
        self.processes = []
        tag = f"{random.getrandbits(32):08x}"
        self.robot, self.other = f"rips-{tag}-robot", f"rips-{tag}-other"
        self.made = []

    def build(self):
        need_namespaces()
        for namespace in (self.robot, self.other):
            self.ip("netns", "add", namespace)
            self.made.append(namespace)
        self.ip("-n", self.robot, "link", "add", "eth0", "type", "veth", "peer", "name", "eth0",
                "netns", self.other)
        for namespace, address in ((self.robot, ROBOT), (self.other, OTHER)):
            for interface in ("lo", "eth0"):
                self.ip("-n", namespace, "link", "set", interface, "up")
            self.ip("-n", namespace, "addr", "add", f"{address}/24", "dev", "eth0")
            self.ip("-n", namespace, "route", "add", "224.0.0.0/4", "dev", "eth0")

    @staticmethod
    def ip(*args):
        subprocess.run(["ip", *args], check=True, stdout=subprocess.DEVNULL)

    def start(self, name, namespace, *args, xml=None):
        env = {key: value for key, value in os.environ.items() if key != "CYCLONEDDS_URI"}
        if xml is not None:
            env["CYCLONEDDS_URI"] = f"<CycloneDDS><Domain>{xml}</Domain></CycloneDDS>"
        process = Process(name, ["ip", "netns", "exec", namespace, *args], self.dir, env)
        self.processes.append(process)
        return process

    def start_probe(self, name, namespace, topic="/cmd_vel", xml=None):
        """A subscriber; it counts what it gets."""
        probe = self.start(name, namespace, self.bin / "robot_sim", "probe", "--domain",
                           self.domain, "--interface", "eth0", "--topic", topic, "--type",
                           "geometry_msgs/msg/Twist", "--window-ms", "200", xml=xml)
        probe.wait_for(lambda line: '"event":"ready"' in line, 15, f"{name} starts")
        return probe

    def start_driver(self, name, namespace, *options, xml=None):
        """A publisher of /cmd_vel, 20 samples a second."""
        driver = self.start(name, namespace, self.bin / "robot_sim", "intruder", "--domain",
                            self.domain, "--interface", "eth0", "--mode", "rogue-cmd-vel",
                            "--node", f"/{name}", *options, xml=xml)
        driver.wait_for(lambda line: '"event":"first_sample"' in line, 15, f"{name} starts")
        return driver

    def start_sensor(self, xml=None):
        """rips-sensor without a policy server: what it finds it also logs."""
        mint = [SOURCE / "deploy/pki/mint", "--dir", self.dir / "pki", "--trust-domain",
                "wire.example"]
        subprocess.run([*mint, "init"], check=True, stdout=subprocess.DEVNULL)
        subprocess.run([*mint, "sensor", "r1", "base"], check=True, stdout=subprocess.DEVNULL)
        pki = self.dir / "pki/sensor/r1/base"
        (self.dir / "sensor.yaml").write_text(f"""robot: r1
host: base
servers: ["127.0.0.1:1"]
tls: {{ca: {pki}/ca.pem, cert: {pki}/cert.pem, key: {pki}/key.pem}}
dds: {{domain: {self.domain}, interface: eth0}}
raw_readers: [/cmd_vel]
wire: {{enabled: true, socket: {self.socket}}}
state_dir: {self.dir}/sensor
metrics: ""
""")
        sensor = self.start("sensor", self.robot, self.bin / "rips-sensor", "--config",
                            self.dir / "sensor.yaml", xml=xml)
        sensor.wait_for(lambda line: " watching " in line, 15, "the sensor starts")
        return sensor

    def start_tap(self, *options):
        return self.start("tap", self.robot, self.bin / "rips-wire", "--domain", self.domain,
                          "--socket", self.socket, *options)

    def watch(self, xml=None):
        """Sensor and tap, connected."""
        self.sensor = self.start_sensor(xml)
        self.tap = self.start_tap()
        self.sensor.wait_for(lambda line: "rips-wire connected" in line, 15, "the tap connects")

    def watch_and_tell(self, rules):
        """Policy server, sensor and tap on the robot; gives the fleet."""
        fleet = Fleet(self.bin, self.dir / "fleet", bundle="wire")
        fleet.within = ["ip", "netns", "exec", self.robot]
        fleet.domain, fleet.processes = self.domain, self.processes
        fleet.env["CYCLONEDDS_URI"] = (
            f"<CycloneDDS><Domain>{at_index(SENSOR_INDEX)}</Domain></CycloneDDS>")
        fleet.probed = "/cmd_vel"
        fleet.sensor_options = f"wire: {{enabled: true, socket: {self.socket}}}\n"
        fleet.write("bundles/wire/manifest.yaml",
                    "name: wire\nrules: [wire.rul]\nlevels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
        fleet.write("bundles/wire/wire.rul", rules)
        fleet.prepare()
        fleet.start_server()
        self.sensor = fleet.start_agent("sensor")
        self.tap = self.start_tap()
        self.sensor.wait_for(lambda line: "rips-wire connected" in line, 15, "the tap connects")
        return fleet

    def start_writer(self, *options):
        """Node /navigator of another host; writes /cmd_vel without multicast, 50 samples a second."""
        writer = self.start("writer", self.other, self.bin / "dds_peer", "--domain", self.domain,
                            "--interface", "eth0", "--node", "/navigator", "--publish",
                            "rt/cmd_vel,geometry_msgs::msg::dds_::Twist_,reliable", "--readers", 2,
                            *options, xml=SPDP)
        writer.wait_for(lambda line: line == "matched", 20, "the writer has both its readers")
        return writer

    def findings(self, word=" finding "):
        return [fields(text) for _, text in self.sensor.lines if word in text]

    def wait_finding(self, kind, seconds=30, word=" finding ", **wanted):
        def found(line):
            if word not in line or f"kind={kind}" not in line:
                return None
            have = fields(line)
            return have if all(have[key] == value for key, value in wanted.items()) else None
        return self.sensor.wait_for(found, seconds, f"{kind} is found")[1]

    def wait_samples(self, probe, seconds=20, start=0):
        return probe.wait_for(lambda line: '"event":"rate"' in line and '"samples":0,' not in line,
                              seconds, "samples arrive", start)

    def stop(self):
        for process in reversed(self.processes):
            try:
                process.kill()
            except Failed as failed:
                print(f"warning: {failed}", file=sys.stderr)
        for namespace in self.made:
            subprocess.run(["ip", "netns", "del", namespace], check=False)


ETH0 = '<General><Interfaces><NetworkInterface name="eth0"/></Interfaces>{}</General>'
# As ROS 2 processes come: multicast, unicast ports from the kernel.
USUAL = ETH0.format("") + "<Discovery><ParticipantIndex>none</ParticipantIndex></Discovery>"
# No multicast but for discovery, as for wireless networks.
SPDP = (ETH0.format("<AllowMulticast>spdp</AllowMulticast>") +
        "<Discovery><ParticipantIndex>none</ParticipantIndex></Discovery>")


def hiding(*peers):
    """Speaks to those peers alone, and never by multicast."""
    listed = "".join(f'<Peer address="{each}"/>' for each in peers)
    return (ETH0.format("<AllowMulticast>false</AllowMulticast>") +
            f"<Discovery><ParticipantIndex>none</ParticipantIndex><Peers>{listed}</Peers>"
            "</Discovery>")


def at_index(index):
    """Receives on the ports of that participant index (DDSI-RTPS 2.5 §9.6.2.3)."""
    return ETH0.format("") + f"<Discovery><ParticipantIndex>{index}</ParticipantIndex></Discovery>"


def meta_port(domain, index):
    return 7400 + 250 * domain + 10 + 2 * index


def data_port(domain, index):
    return meta_port(domain, index) + 1


class Sniffer:
    """Datagrams with DATA of users' writers that a host sends or gets."""

    def __init__(self, world, namespace):
        # A socket belongs to the namespace of the thread that makes it.
        here = os.open("/proc/self/ns/net", os.O_RDONLY)
        there = os.open(f"/run/netns/{namespace}", os.O_RDONLY)
        try:
            setns(there)
            self.packets = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(3))
        finally:
            setns(here)
            os.close(here)
            os.close(there)
        self.packets.settimeout(15)

    def data_from(self, address):
        """(UDP payload, offset of the DATA submessage) of a writer at `address` that goes on and on,
        unlike that of ros_discovery_info."""
        deadline = time.monotonic() + 15
        seen = {}
        while time.monotonic() < deadline:
            packet, _ = self.packets.recvfrom(65536)
            if packet[0] >> 4 != 4 or packet[9] != 17 or socket.inet_ntoa(packet[12:16]) != address:
                continue
            payload = packet[(packet[0] & 15) * 4 + 8:]
            at = find_data(payload)
            if at is None:
                continue
            guid = writer_of(payload, at)
            numbers = seen.setdefault(guid, set())
            numbers.add(payload[at + 16:at + 24])
            if len(numbers) == 5:
                return payload, at
        raise Failed(f"no data of {address} is on the wire")

    def close(self):
        self.packets.close()


def setns(fd):
    import ctypes
    if ctypes.CDLL(None, use_errno=True).setns(fd, 0) != 0:
        raise Failed(f"setns: {os.strerror(ctypes.get_errno())}")


def find_data(payload):
    """Where the first DATA of a user's writer begins; None if there is none."""
    at = 20
    while payload[:4] == b"RTPS" and at + 24 <= len(payload):
        kind, flags = payload[at], payload[at + 1]
        length = struct.unpack("<H" if flags & 1 else ">H", payload[at + 2:at + 4])[0]
        if kind == 0x15 and payload[at + 15] < 0x40:
            return at
        at += 4 + (length or (0 if kind in (1, 9) else len(payload)))
    return None


def writer_of(payload, at):
    """The GUID as it is logged."""
    guid = (payload[8:20] + payload[at + 12:at + 16]).hex()
    return ".".join(guid[i:i + 8] for i in range(0, 32, 8))


def with_sequence(payload, at, sequence):
    order = "<" if payload[at + 1] & 1 else ">"
    return (payload[:at + 16] + struct.pack(order + "iI", *divmod(sequence, 1 << 32)) +
            payload[at + 24:])


def heartbeat(payload, at, first, last):
    """HEARTBEAT of the writer of that DATA, to all readers."""
    numbers = struct.pack("<iIiII", *divmod(first, 1 << 32), *divmod(last, 1 << 32), 1)
    return (payload[:20] + struct.pack("<BBH", 7, 1, 28) + bytes(4) + payload[at + 12:at + 16] +
            numbers)


def send_from(namespace, payload, port, source_port=0):
    """One datagram to the robot from an ordinary socket of that host."""
    code = ("import socket, sys; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); "
            f"s.bind(('', {source_port})); "
            f"s.sendto(bytes.fromhex('{payload.hex()}'), ('{ROBOT}', {port}))")
    subprocess.run(["ip", "netns", "exec", namespace, sys.executable, "-c", code], check=True)


# ------------------------------------------------------------------------------------ scenarios


def unicast_only_writer(world):
    """The victim gets its commands; discovery shows the sensor nothing of it."""
    victim = world.start_probe("victim", world.robot, xml=at_index(VICTIM_INDEX))
    world.watch()
    port = meta_port(world.domain, VICTIM_INDEX)
    world.start_driver("attacker", world.other, "--anonymous", xml=hiding(f"{ROBOT}:{port}"))

    world.wait_samples(victim)
    found = world.wait_finding("unicast_writer")

    check(f"from {OTHER}:" in found["detail"] and f" to {ROBOT}:{port + 1}," in found["detail"],
          f"not from there to there: {found}")
    check(found["guid"].startswith("0110") and found["guid"].endswith("03"), f"no writer: {found}")
    check({each["guid"] for each in world.findings()} == {found["guid"]},
          f"more was found: {world.findings()}")


def unicast_only_writer_to_a_port_of_the_kernel(world):
    """As processes are set up by default: their unicast ports are anywhere."""
    world.watch()
    victim = world.start_probe("victim", world.robot, xml=USUAL)
    ports = subprocess.run(["ip", "netns", "exec", world.robot, "ss", "-Hulnp"],
                           capture_output=True, text=True).stdout
    own = [int(line.split()[3].rsplit(":", 1)[1]) for line in ports.splitlines()
           if f"pid={victim.child.pid}," in line]
    own = [port for port in own if port >= 32768]
    check(own, f"the victim has no port of the kernel's: {ports}")

    peers = [f"{ROBOT}:{port}" for port in own]
    world.start_driver("attacker", world.other, "--anonymous", xml=hiding(*peers))

    found = world.wait_finding("unicast_writer")
    check(any(f" to {peer}," in found["detail"] for peer in peers), f"not to the victim: {found}")


def injected_data(world):
    """One datagram under the name of a writer that is there."""
    world.start_probe("victim", world.robot, xml=at_index(VICTIM_INDEX))
    world.watch()
    sniffer = Sniffer(world, world.robot)
    world.start_driver("driver", world.robot, xml=USUAL)
    payload, at = sniffer.data_from(ROBOT)
    sniffer.close()
    guid = writer_of(payload, at)

    send_from(world.other, with_sequence(payload, at, 1000),
              meta_port(world.domain, VICTIM_INDEX) + 1, 45678)

    found = world.wait_finding("spoofed_writer", guid=guid)
    check(found["detail"].startswith(f"{OTHER}:45678 sends under this name"), f"{found}")
    check(found["topic"] == "/cmd_vel" and found["node"] == "/driver", f"{found}")
    # Where the true writer says by HEARTBEAT how far it is, the forged number is found, too.
    kinds = {each["kind"] for each in world.findings()}
    check(kinds <= {"spoofed_writer", "sequence_jump"}, f"more was found: {world.findings()}")


def injected_data_from_the_same_host(world):
    world.start_probe("victim", world.robot, xml=at_index(VICTIM_INDEX))
    world.watch()
    sniffer = Sniffer(world, world.robot)
    world.start_driver("driver", world.robot, xml=USUAL)
    payload, at = sniffer.data_from(ROBOT)
    sniffer.close()

    send_from(world.robot, with_sequence(payload, at, 1000),
              meta_port(world.domain, VICTIM_INDEX) + 1, 45678)

    found = world.wait_finding("spoofed_writer", guid=writer_of(payload, at))
    check(f"{ROBOT}:45678 sends under this name, which its participant uses from {ROBOT}:"
          in found["detail"], f"{found}")


READS_COMMANDS = """levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules Msg:
  here: topicin("/cmd_vel") && publishersinclude("/navigator") && CurrLevel < ALERT ?
    alert("a command") => trigger(ALERT);
rules Graph:
  unused: false ? trigger(COMPROMISED), trigger(HALT);
"""


def told(fleet, text):
    return [each["text"] for each in fleet.alerts() if text in each["text"]]


def wait_told(fleet, text, seconds=30):
    deadline = time.monotonic() + seconds
    while not told(fleet, text):
        check(time.monotonic() < deadline, f"`{text}` is not told: {fleet.alerts()}")
        time.sleep(0.2)
    return told(fleet, text)[0]


def directed_data(world):
    """A writer that discovery shows and that has matched our reader sends to the victim alone."""
    victim = world.start_probe("victim", world.robot, xml=at_index(VICTIM_INDEX))
    fleet = world.watch_and_tell(READS_COMMANDS)

    writer = world.start_writer("--withhold", f"{ROBOT}:{data_port(world.domain, SENSOR_INDEX)}")
    prefix = next(text.split()[1] for _, text in writer.lines if text.startswith("up "))

    world.wait_samples(victim)
    text = wait_told(fleet, "finding directed_data")
    check("topic /cmd_vel" in text and f"GUID {prefix[:8]}.{prefix[8:16]}." in text, text)
    check(not told(fleet, "a command"), "the rule saw what was kept from the sensor")
    world.wait_samples(victim, start=len(victim.lines))
    # Its node's name is data, too, and does not reach us either.
    kinds = {each["kind"] for each in world.findings()}
    check({"directed_data"} <= kinds <= {"directed_data", "non_ros_writer"}, f"{world.findings()}")


def undirected_data(world):
    """The same writer when it keeps nothing back, also when it stops for a while and goes on."""
    victim = world.start_probe("victim", world.robot, xml=at_index(VICTIM_INDEX))
    fleet = world.watch_and_tell(READS_COMMANDS)

    writer = world.start_writer()

    wait_told(fleet, "a command")
    for sig in (signal.SIGSTOP, signal.SIGCONT):
        os.kill(writer.child.pid, sig)
        time.sleep(6)  # longer than a writer may go on without us
    world.wait_samples(victim, start=len(victim.lines))
    check(not world.findings(), f"found in quiet traffic: {world.findings()}")
    check(not told(fleet, "finding"), f"told without a reason: {told(fleet, 'finding')}")


FAR = 1 << 40
# Seconds from the attack to its finding.
SOON = 5


def watch_writer(world, topic):
    """A writer of the robot, read by sensor and victim: DATA of it, its offset, the GUID."""
    world.start_probe("victim", world.robot, topic, xml=at_index(VICTIM_INDEX))
    world.watch(xml=at_index(SENSOR_INDEX))
    sniffer = Sniffer(world, world.robot)
    if topic == "/cmd_vel":
        world.start_driver("driver", world.robot, xml=USUAL)
    else:
        world.start("latched", world.robot, world.bin / "dds_peer", "--domain", world.domain,
                    "--interface", "eth0", "--node", "/latched", "--publish",
                    f"rt{topic},geometry_msgs::msg::dds_::Twist_,latched", "--bytes", 52,
                    "--readers", 2, xml=USUAL)
    payload, at = sniffer.data_from(ROBOT)
    sniffer.close()
    return payload, at, writer_of(payload, at)


def number_far_ahead(world):
    """One datagram to the sensor alone, which makes its reader drop all that the writer sends."""
    payload, at, guid = watch_writer(world, "/cmd_vel")

    send_from(world.robot, with_sequence(payload, at, FAR), data_port(world.domain, SENSOR_INDEX))

    world.wait_finding("sequence_jump", SOON, guid=guid)


def heartbeat_far_ahead(world):
    """The same by HEARTBEAT, for a reliable reader."""
    payload, at, guid = watch_writer(world, "/map")

    send_from(world.robot, heartbeat(payload, at, FAR, FAR), data_port(world.domain, SENSOR_INDEX))

    world.wait_finding("sequence_jump", SOON, guid=guid)


def two_contents(world):
    """The victim gets other bytes than the sensor, from the same writer and under the same number."""
    world.start_probe("victim", world.robot, xml=at_index(VICTIM_INDEX))
    fleet = world.watch_and_tell(READS_COMMANDS)
    sniffer = Sniffer(world, world.robot)
    world.start_driver("driver", world.robot, xml=USUAL)
    payload, at = sniffer.data_from(ROBOT)
    sniffer.close()
    order = "<H" if payload[at + 1] & 1 else ">H"
    length = struct.unpack(order, payload[at + 2:at + 4])[0]
    last = at + 3 + length if length > 0 else len(payload) - 1
    other = payload[:last] + bytes([payload[last] ^ 0x40]) + payload[last + 1:]

    send_from(world.robot, other, data_port(world.domain, VICTIM_INDEX))

    guid = writer_of(payload, at)
    found = world.wait_finding("two_contents", SOON, guid=guid, topic="/cmd_vel", node="/driver")
    port = data_port(world.domain, VICTIM_INDEX)
    check(f" goes to {ROBOT}:{port} with another content" in found["detail"], f"{found}")
    deadline = time.monotonic() + SOON
    wanted = ("it sends others what does not come to us",
              "wire tap: a writer sends others what does not come to the sensor", "two_contents")
    while True:
        code, text, _ = fleet.ripsctl("robot", "coverage", "r1", check=False)
        if code == 1 and all(words in text for words in wanted):
            return
        check(time.monotonic() < deadline, f"coverage ends with {code}: {text}")
        time.sleep(0.2)


def quiet_traffic(world):
    """Five participants on two hosts, with multicast and without, that come and go: no finding."""
    world.watch()
    probes = [world.start_probe("probe1", world.robot, xml=USUAL),
              world.start_probe("probe2", world.other, xml=SPDP)]
    for round_number in range(3):
        drivers = [world.start_driver(f"near{round_number}", world.robot, xml=USUAL),
                   world.start_driver(f"far{round_number}", world.other, xml=USUAL),
                   world.start_driver(f"wireless{round_number}", world.other, xml=SPDP)]
        starts = [len(each.lines) for each in probes]
        for probe, start in zip(probes, starts):
            world.wait_samples(probe, start=start)
        time.sleep(4)  # longer than the grace
        # One leaves, two die.
        drivers[0].kill()
        for each in drivers[1:]:
            each.kill(signal.SIGKILL)
    time.sleep(13)  # longer than the lease of the dead, and the grace of those who announce
    check(not world.findings(), f"found in quiet traffic: {world.findings()}")
    check(world.tap.running and world.sensor.running, "tap or sensor has ended")


def tap_and_sensor_come_and_go(world):
    """Each finds the other again. Who came and left while there was no sensor is no finding; who
    hides is, as soon as there is one."""
    world.watch()
    world.tap.kill()
    check(world.tap.child.returncode == 0, f"the tap ended with {world.tap.child.returncode}")
    world.sensor.wait_for(lambda line: "rips-wire disconnected" in line, 10, "the tap is missed")
    world.sensor.kill()
    check(not os.path.exists(world.socket), "the socket is left over")
    world.tap = world.start_tap()
    world.tap.wait_for(lambda line: "listening" in line, 10, "the tap listens")
    victim = world.start_probe("victim", world.robot, xml=at_index(VICTIM_INDEX))
    guest = world.start_driver("guest", world.other, xml=USUAL)
    world.wait_samples(victim)
    guest.kill(signal.SIGKILL)
    port = meta_port(world.domain, VICTIM_INDEX)
    world.start_driver("attacker", world.other, "--anonymous", xml=hiding(f"{ROBOT}:{port}"))

    world.sensor = world.start_sensor()

    world.wait_finding("unicast_writer")
    time.sleep(13)  # longer than the grace of those who announce
    check(len(world.findings()) == 1, f"more was found: {world.findings()}")


def tap_gives_up_its_privileges(world):
    world.watch()
    status = pathlib.Path(f"/proc/{world.tap.child.pid}/status").read_text()
    held = dict(line.split(":", 1) for line in status.splitlines())
    for name in ("CapPrm", "CapEff", "CapInh", "CapAmb"):
        check(int(held[name], 16) == 0, f"{name} is {held[name]}")
    check(held["NoNewPrivs"].strip() == "1", "it may gain privileges")

def tap_ends_with_its_interface(world):
    named = world.start("named", world.robot, world.bin / "rips-wire", "--domain", world.domain,
                        "--socket", world.socket, "--interface", "eth0")
    named.wait_for(lambda line: " listening " in line, 10, "the tap listens")
    world.ip("-n", world.robot, "link", "set", "eth0", "down")
    named.wait_for(lambda line: "interface is down" in line, 10, "it notices")
    check(named.running, "an interface that is down ended it")
    world.ip("-n", world.robot, "link", "del", "eth0")
    named.wait_for(lambda line: "is gone" in line, 10, "it notices that, too")
    check(named.child.wait(10) == 1, f"it ended with {named.child.returncode}")


def tap_tells_what_is_wrong_with_its_flags(world):
    def run(*args):
        done = subprocess.run([world.bin / "rips-wire", *args], capture_output=True, text=True,
                              timeout=30, check=False)
        return done.returncode, done.stdout + done.stderr

    for args, code, text in (
            (("--domain", "233"), 2, "domain 233 exceeds limit 232"),
            (("--domain", "x"), 2, "--domain"),
            (("--nonsense",), 2, "nonsense"),
            (("--log-level", "loud"), 2, "loud"),
            (sum((("--interface", "lo") for _ in range(17)), ()), 2, "17 interfaces exceed limit 16"),
            (("--interface", "none0"), 1, "there is no network interface `none0`"),
            (("--version",), 0, "rips-wire ")):
        have = run(*args)
        check(have[0] == code and text in have[1], f"{args}: {have}")


SCENARIOS = [unicast_only_writer, unicast_only_writer_to_a_port_of_the_kernel, injected_data,
             injected_data_from_the_same_host, directed_data, undirected_data, number_far_ahead,
             heartbeat_far_ahead, two_contents, quiet_traffic, tap_and_sensor_come_and_go,
             tap_gives_up_its_privileges, tap_ends_with_its_interface,
             tap_tells_what_is_wrong_with_its_flags]


def main():
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    scenario = next(each for each in SCENARIOS if each.__name__ == sys.argv[2])
    directory = pathlib.Path(tempfile.mkdtemp(prefix="rips-wire."))
    def build_and_play(world):
        world.build()
        scenario(world)
    code = perform(scenario.__name__, build_and_play, World(sys.argv[1], directory))
    shutil.rmtree(directory, ignore_errors=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
