"""A robot's host in a network namespace whose addresses change: the agents follow. The policy server
is on its loopback interface, which stays.

    addresses_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import os
import pathlib
import re
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import Failed, Fleet, check, eventually, play  # noqa: E402
from network import Network, need_namespaces, run  # noqa: E402

BEFORE, AFTER, SECOND = "10.77.0.2", "10.77.0.3", "10.77.0.4"
SECONDS_MAX = 30 if os.environ.get("RIPS_SANITIZE") else 10  # once the robot is back


class Moving(Fleet):
    """All in the namespace `robot`; DDS on eth0."""

    interface = "eth0"

    def __init__(self, binaries, directory, **options):
        super().__init__(binaries, directory, floor_hold="1s", **options)
        self.env["CYCLONEDDS_URI"] = ""
        self.network = Network(f"ripsmove{os.getpid()}", {"robot": BEFORE})
        self.within = self.network.within("robot")

    def prepare(self):
        need_namespaces()
        self.network.build()
        super().prepare()

    def stop(self):
        super().stop()
        self.network.remove()

    def ip(self, *args):
        run("ip", "-n", self.network.ns("robot"), *args)

    def move(self, before, after):
        self.ip("address", "del", f"{before}/24", "dev", "eth0")
        self.ip("address", "add", f"{after}/24", "dev", "eth0")

    def delete_interface(self):
        self.ip("link", "delete", "eth0")

    def make_interface(self, address):
        switch = self.network.ns("switch")
        run("ip", "-n", switch, "link", "add", "robot", "type", "veth", "peer", "name", "eth0",
            "netns", self.network.ns("robot"))
        run("ip", "-n", switch, "link", "set", "robot", "master", "br0", "up")
        self.ip("link", "set", "eth0", "up")
        self.ip("address", "add", f"{address}/24", "dev", "eth0")

    def restart_robot(self):
        self.robot.kill()
        self.robot = self.start_robot()
        return time.monotonic()

    def raise_to_halt(self):
        self.ripsctl("level", "raise", "r1", "--to", "HALT", "--reason", "stop")

    def attack_and_halt(self, since):
        """The robot is back since then: an attack is seen, and an operator stops the robot."""
        self.start_intruder("rogue-cmd-vel")
        self.wait_level("COMPROMISED", SECONDS_MAX - (time.monotonic() - since))
        attacked = time.monotonic() - since
        self.raise_to_halt()
        self.wait_level("HALT", SECONDS_MAX - (time.monotonic() - since))
        halted = time.monotonic() - since
        check(self.mode()["mode"] == "HALT", "the robot is not at HALT")
        print(f"attack answered {attacked:.1f} s, HALT verified {halted:.1f} s after the robot was "
              "back")

    def told(self):
        """Alerts that DDS begins again."""
        return [each["text"] for each in self.alerts() if "DDS begins again: " in each["text"]]

    def watched(self):
        """The participants that the sensor had, oldest first."""
        return [match[1] for _, text in self.sensor.lines
                if (match := re.search(r" watching .*participant=(\S+)", text))]

    def counts(self):
        return {agent.name: len(agent.lines) for agent in (self.sensor, self.actuator)}


def quiet(fleet, seconds):
    """Neither agent logs anything about its network for so long; Cyclone writes nine lines a second
    while it has an address that is gone."""
    before = fleet.counts()
    time.sleep(seconds)
    for agent in (fleet.sensor, fleet.actuator):
        new = [text for _, text in agent.lines[before[agent.name]:]]
        check(not any("failed" in text for text in new), f"{agent.name} still logs {new[:3]}")


def follows_another_address(fleet):
    """The host gets another address, and the ROS nodes are started again on it."""
    fleet.arm()
    fleet.move(BEFORE, AFTER)
    fleet.attack_and_halt(fleet.restart_robot())
    changed = f"eth0 had {BEFORE} and has {AFTER}"
    for agent in (fleet.sensor, fleet.actuator):
        said = [text for _, text in agent.lines if changed in text and "begins again" in text]
        check(len(said) == 1, f"{agent.name} says {said}")
    check(len(fleet.told()) == 1 and changed in fleet.told()[0], f"alerts: {fleet.told()}")
    check(not any("restarted" in each["text"] for each in fleet.alerts()), "it counts as a restart")
    quiet(fleet, 1)


def interface_goes_and_comes_back(fleet):
    """It is deleted and made again with the same address. In between the evidence is incomplete,
    coverage says why, and what an operator orders is carried out when the robot is back."""
    fleet.arm()
    lost = f"DDS begins again: eth0 lost {BEFORE} and has no other address"
    fleet.ripsctl("level", "raise", "r1", "--to", "ALERT", "--reason", "to see that it stays")
    fleet.wait_level("ALERT", 20)
    fleet.delete_interface()
    eventually(lambda: any(lost in each for each in fleet.level()["degraded"]), 5, "not degraded")
    code, out, _ = fleet.ripsctl("robot", "coverage", "r1", check=False)
    check(code == 1 and f"BLIND: sensor base: {lost}\n" in out, f"coverage: {code}, {out}")
    code, _, error = fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--reason", "try",
                                   check=False)
    check(code == 1 and lost in error, f"a blind lowering was not refused: {code} {error}")
    fleet.raise_to_halt()
    for agent, waits in ((fleet.sensor, "sees nothing on DDS; waiting for a network interface"),
                         (fleet.actuator, "System Modes unreachable")):
        agent.wait_for(lambda text, waits=waits: waits in text, 15, f"{agent.name} ends its DDS part")
    quiet(fleet, 1)
    check(fleet.level()["stage"] != "verified", "verified although the robot cannot be reached")
    fleet.make_interface(BEFORE)
    back = fleet.restart_robot()
    fleet.wait_level("HALT", SECONDS_MAX)
    halted = time.monotonic() - back
    fleet.start_intruder("rogue-cmd-vel")
    eventually(lambda: any(each["rule"] == "rogue_driver" for each in fleet.alerts()),
               SECONDS_MAX - (time.monotonic() - back), "the attack is not seen")
    print(f"HALT of the outage verified {halted:.1f} s, attack seen {time.monotonic() - back:.1f} s "
          "after the robot was back")
    eventually(lambda: not any("DDS begins again" in each for each in fleet.level()["degraded"]), 5,
               "still degraded")
    check(len(fleet.told()) == 1, f"alerts: {fleet.told()}")


def other_addresses_disturb_nothing(fleet):
    """A second address of the interface, and interfaces that come and go several times a second;
    and an interface that is down for a moment."""
    fleet.arm()
    before = fleet.watched()
    fleet.ip("address", "add", f"{SECOND}/24", "dev", "eth0")
    end = time.monotonic() + 5
    for number in range(1000):
        fleet.ip("link", "add", f"veth{number}", "type", "veth", "peer", "name", f"peer{number}")
        fleet.ip("address", "add", "172.18.0.1/16", "dev", f"veth{number}")
        fleet.ip("link", "set", f"veth{number}", "up")
        time.sleep(0.2)
        fleet.ip("link", "delete", f"veth{number}")
        if time.monotonic() > end:
            break
    fleet.ip("link", "set", "eth0", "down")
    fleet.ip("link", "set", "eth0", "up")
    fleet.attack_and_halt(time.monotonic())
    check(fleet.watched() == before, "the sensor has begun again")
    check(not fleet.told(), f"alerts: {fleet.told()}")
    for agent in (fleet.sensor, fleet.actuator):
        check(not any("begins again" in text for _, text in agent.lines), f"{agent.name} did, too")


def starts_before_its_address(fleet):
    """At boot: the agents run before the interface is there, and say what they wait for."""
    fleet.prepare()
    fleet.delete_interface()
    fleet.server = fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")
    fleet.actuator = fleet.start_agent("actuator")
    absent = "there is no network interface `eth0` here, only lo; see `dds.interface`"
    eventually(lambda: sum(absent in each for each in fleet.level()["degraded"]) == 2, 10,
               "it is not said what the agents wait for")
    check(not any("sees no ROS node" in each for each in fleet.level()["degraded"]), "wrong advice")
    fleet.make_interface(BEFORE)
    fleet.robot = fleet.start_robot()
    since = time.monotonic()
    fleet.wait_level("DEFAULT", SECONDS_MAX)
    fleet.attack_and_halt(since)
    check(not fleet.told(), f"alerts: {fleet.told()}")


def cyclones_choice_is_followed(fleet):
    """No interface is configured, and at the start there is loopback alone."""
    fleet.interface = '""'
    fleet.prepare()
    fleet.delete_interface()
    fleet.server = fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")
    fleet.actuator = fleet.start_agent("actuator")
    fleet.interface = ""
    fleet.make_interface(BEFORE)
    for agent in (fleet.sensor, fleet.actuator):
        agent.wait_for(lambda text: f"eth0 came with {BEFORE}; lo with 127.0.0.1 was used" in text,
                       8, f"{agent.name} follows")
    fleet.robot = fleet.start_robot()
    since = time.monotonic()
    fleet.wait_level("DEFAULT", SECONDS_MAX)
    fleet.attack_and_halt(since)


SCENARIOS = [follows_another_address, interface_goes_and_comes_back,
             other_addresses_disturb_nothing, starts_before_its_address,
             cyclones_choice_is_followed]

if __name__ == "__main__":
    sys.exit(play(SCENARIOS, Moving))
