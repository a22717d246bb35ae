"""One forged packet that makes a sensor deaf: sequence numbers that no writer reaches, sent to the
sensor alone, without a key. In network namespaces of their own: a robot, and another host on its
network. Real processes: policy server, rips-sensor, rips-wire, DDS peers.

    numbers_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import os
import pathlib
import shutil
import struct
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[0] / "integration"))
sys.path.insert(0, str(HERE.parents[0] / "support"))
import wire_test  # noqa: E402
from fleet import Failed, Fleet, check, eventually, metrics, perform  # noqa: E402
from wire_test import SENSOR_INDEX, SPDP, World, data_port, send_from  # noqa: E402

FORGED = 1 << 40
SEEN_S = 5
# The writer of a peer's first topic, which has no key (DDSI-RTPS 2.5 §9.3.1.2); Cyclone DDS counts
# entities from 1.
FIRST_WRITER = bytes.fromhex("00000103")
RULES = """levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules Msg:
  attack: topicin("/cmd_vel") && payloadsize(2000, 2100) && CurrLevel < ALERT ?
    alert("the attack") => trigger(ALERT);
  others: topicin("/scan", "/map") && payloadsize(999999, 1000000) ? alert("never");
rules Graph:
  unused: false ? trigger(COMPROMISED), trigger(HALT);
"""


def packet(prefix, *submessages):
    return b"RTPS\x02\x01\x01\x10" + bytes.fromhex(prefix) + b"".join(
        struct.pack("<BBH", kind, flags, len(body)) + body for kind, flags, body in submessages)


def number(value):
    return struct.pack("<iI", value >> 32, value & 0xffffffff)


def data(prefix, sequence):
    """DATA of that participant's first writer: an empty string."""
    return packet(prefix, (0x15, 0x05, struct.pack("<HH", 0, 16) + bytes(4) + FIRST_WRITER +
                           number(sequence) + bytes.fromhex("000100000100000000000000")))


def heartbeat(prefix, first):
    return packet(prefix, (0x07, 0x01, bytes(4) + FIRST_WRITER + number(first) + number(first) +
                           struct.pack("<I", 1000)))


class Deaf:
    """A robot under watch, and what is done to its sensor."""

    def __init__(self, world, tap):
        self.world = world
        fleet = self.fleet = Fleet(world.bin, world.dir / "fleet", bundle="numbers")
        fleet.within = ["ip", "netns", "exec", world.robot]
        fleet.domain, fleet.processes = world.domain, world.processes
        fleet.env["CYCLONEDDS_URI"] = (
            f"<CycloneDDS><Domain>{wire_test.at_index(SENSOR_INDEX)}</Domain></CycloneDDS>")
        fleet.probed = "/cmd_vel, /scan, /map"
        if tap:
            fleet.sensor_options = f"wire: {{enabled: true, socket: {world.socket}}}\n"
        fleet.write("bundles/numbers/manifest.yaml",
                    "name: numbers\nrules: [numbers.rul]\n"
                    "levels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
        fleet.write("bundles/numbers/numbers.rul", RULES)
        fleet.prepare()
        fleet.start_server()
        self.sensor = fleet.start_agent("sensor")
        if tap:
            world.start_tap()
            self.sensor.wait_for(lambda line: "rips-wire connected" in line, 15, "the tap connects")

    def start_peer(self, name, topic, *options):
        peer = self.world.start(name, self.world.other, self.world.bin / "dds_peer", "--domain",
                                self.world.domain, "--interface", "eth0", "--node", f"/{name}",
                                "--publish",
                                f"rt/{topic},geometry_msgs::msg::dds_::Twist_{options[0]}",
                                *options[1:], xml=SPDP)
        prefix = peer.wait_for(lambda line: line.startswith("up ") and line.split()[1], 20,
                               f"{name} is up")[1]
        return peer, prefix

    def send(self, payload):
        """To the sensor alone, from another host and port than the writer's."""
        send_from(self.world.other, payload, data_port(self.world.domain, SENSOR_INDEX))

    def found(self, prefix, topic, since):
        """Waits at most SEEN_S for the finding of that participant's topic at the server, and code
        1 of `coverage`. Gives the seconds since then."""
        participant = f"participant {prefix[:8]}.{prefix[8:16]}.{prefix[16:]}.000001c1"
        shown = None

        def seen():
            nonlocal shown
            code, shown, _ = self.fleet.ripsctl("robot", "coverage", "r1", check=False)
            lines = shown.splitlines()
            return (code == 1 and
                    any("sequence_jump" in line and participant in line for line in lines) and
                    any(topic in line and "not visible: sequence numbers jumped" in line
                        for line in lines))
        try:
            eventually(seen, SEEN_S, f"sequence_jump of {participant} and coverage 1")
        except Failed:
            print(shown)
            raise
        return time.monotonic() - since

    def samples(self):
        here = os.open("/proc/self/ns/net", os.O_RDONLY)
        there = os.open(f"/run/netns/{self.world.robot}", os.O_RDONLY)
        try:
            wire_test.setns(there)
            return metrics(self.sensor)["rips_sensor_samples_total"]
        finally:
            wire_test.setns(here)
            os.close(here)
            os.close(there)

    def hears(self, what):
        """30 more samples come."""
        start = self.samples()
        eventually(lambda: self.samples() >= start + 30, SEEN_S, f"{what} is heard")

    def first_number(self):
        """An attacker's own writer, whose first packet to the sensor is forged; then the attack."""
        _, prefix = self.start_peer("attacker", "cmd_vel", "", "--bytes", 2000, "--readers", 2)
        time.sleep(1)  # it has matched the sensor's reader; nothing is written yet
        since = time.monotonic()
        for _ in range(2):
            self.send(data(prefix, FORGED))
        self.world.start_probe("victim", self.world.robot, topic="/cmd_vel", xml=None)
        seen_s = self.found(prefix, "/cmd_vel", since)
        wire_test.wait_told(self.fleet, "the attack", SEEN_S)
        return seen_s

    def running(self):
        """An honest writer that runs, and is restarted afterwards."""
        peer, prefix = self.start_peer("laser", "scan", ",reliable", "--readers", 1)
        self.hears("/scan")
        since = time.monotonic()
        for _ in range(2):
            self.send(data(prefix, FORGED))
        seen_s = self.found(prefix, "/scan", since)
        self.hears("/scan after a forged number")
        peer.kill()
        return seen_s

    def latched(self):
        """A latched topic, by one heartbeat."""
        peer, prefix = self.start_peer("mapper", "map", ",latched", "--readers", 1)
        self.hears("/map")
        since = time.monotonic()
        self.send(heartbeat(prefix, FORGED))
        seen_s = self.found(prefix, "/map", since)
        self.hears("/map after a forged heartbeat")
        peer.kill()
        return seen_s

    def is_over(self):
        """Of writers that are discovered again nothing stands."""
        peer, _ = self.start_peer("laser", "scan", ",reliable", "--readers", 1)
        self.hears("/scan of the new writer")
        _, shown, _ = self.fleet.ripsctl("robot", "coverage", "r1", check=False)
        jumped = [line for line in shown.splitlines() if "sequence_jump" in line]
        check(len(jumped) <= 1, f"only the attacker's is left: {shown}")
        peer.kill()


def without_tap(world):
    world.build()
    deaf = Deaf(world, False)
    seen = {each.__name__: each() for each in (deaf.running, deaf.latched, deaf.first_number)}
    deaf.is_over()
    print("seen after", ", ".join(f"{name}: {at:.1f} s" for name, at in seen.items()))


def with_tap(world):
    """As without, where the tap has something to say of it, too."""
    world.build()
    deaf = Deaf(world, True)
    print(f"seen after running: {deaf.running():.1f} s")


SCENARIOS = [without_tap, with_tap]


def main():
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    scenario = next(each for each in SCENARIOS if each.__name__ == sys.argv[2])
    directory = pathlib.Path(tempfile.mkdtemp(prefix="rips-numbers."))
    code = perform(scenario.__name__, scenario, World(sys.argv[1], directory))
    shutil.rmtree(directory, ignore_errors=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
