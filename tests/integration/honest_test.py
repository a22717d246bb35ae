"""An honest robot and what it goes through: it boots, restarts, keeps history for late readers, loses
its network, and runs many short-lived programs. Policy server, sensor, tap and actuator watch it, and
must not report an attack. Network namespaces; real processes.

    honest_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names

RIPS_HONEST=long makes the outage and the number of programs those of a day in the field.
"""

import os
import pathlib
import shutil
import signal
import sys
import tempfile
import time

from wire_test import SPDP, USUAL, World

from fleet import check, perform

LONG = os.environ.get("RIPS_HONEST") == "long"
OUTAGE_S = 60 if LONG else 4
PROGRAMS = 1000 if LONG else 40
TWIST = "geometry_msgs::msg::dds_::Twist_"
# What no honest robot may look like. Programs that end before they are discovered are findings of
# other kinds.
ATTACKS = {"sequence_jump", "two_contents", "rival_server", "spoofed_writer", "directed_data",
           "impostor"}
RULES = """levels: DEFAULT; ALERT; COMPROMISED; HALT;
vars: seen bool = false;
rules Msg:
  fast: topicin("/fast") ? set(seen, true);
  map: topicin("/map") ? set(seen, true);
  camera: topicin("/camera/image_raw") ? set(seen, true);
  drive: topicin("/cmd_vel") ? set(seen, true);
  odom: topicin("/odom") ? set(seen, true);
rules External:
  up: signal("SIGUSR1") ? trigger(ALERT) => trigger(COMPROMISED) => trigger(HALT);
  read: seen && signal("SIGUSR2") ? alert("seen", "info");
"""


def no_attack(world, fleet, after):
    found = [each for each in world.findings() if each["kind"] in ATTACKS]
    check(not found, f"found after {after}: {found}")
    alerts = [each for each in fleet.alerts()
              if any(kind in each["text"] for kind in ATTACKS) or "contradicted" in each["text"]]
    check(not alerts, f"told after {after}: {alerts}")


def peer(world, name, namespace, topic, *options, xml=USUAL):
    return world.start(name, namespace, world.bin / "dds_peer", "--domain", world.domain,
                       "--interface", "eth0", "--node", f"/{name}", "--publish",
                       f"rt/{topic},{TWIST},{options[0]}", *options[1:], xml=xml)


def unwatched(world, fleet):
    """Endpoints that the sensor cannot see, with the reason."""
    return [each for each in fleet.query("robot", "coverage", "r1", check=False)["endpoints"]
            if "sequence" in str(each)]


def honest_robot_is_not_accused(world):
    fleet = world.watch_and_tell(RULES)
    fleet.env["CYCLONEDDS_URI"] = f"<CycloneDDS><Domain>{USUAL}</Domain></CycloneDDS>"
    fleet.interface = "eth0"
    robot = fleet.start_robot()
    fleet.start_agent("actuator")
    fleet.wait_level("DEFAULT", 40)
    no_attack(world, fleet, "the boot")

    # Levels up and down, each read back from parts that stop publishing.
    for verb, level in (("raise", "HALT"), ("lower", "DEFAULT")):
        fleet.ripsctl("level", verb, "r1", "--to", level, "--reason", "test", "--wait",
                      *(("--accept-blind",) if verb == "lower" else ()))
        time.sleep(2.5)  # what would contradict the level is judged a second later
        no_attack(world, fleet, f"{level} was reached")

    # The robot's program crashes, and ends in order.
    for sig in (signal.SIGKILL, signal.SIGTERM):
        robot.kill(sig)
        robot = fleet.start_robot()
        fleet.wait_level("DEFAULT", 40)
    no_attack(world, fleet, "two restarts of the robot")

    # A latched topic, whose history a sensor that starts again reads once more.
    peer(world, "map", world.other, "map", "latched", "--count", "20", "--period-us", "1000",
         "--tail-ms", "500")
    world.sensor.kill(signal.SIGKILL)
    world.sensor = fleet.start_agent("sensor")
    world.sensor.wait_for(lambda line: "rips-wire connected" in line, 30, "the tap connects")
    fleet.wait_level("DEFAULT", 40)
    no_attack(world, fleet, "a restart of the sensor")

    # A fast writer of another host goes on during an outage of the network.
    peer(world, "fast", world.other, "fast", "reliable", "--period-us", "500", xml=USUAL)
    peer(world, "slow", world.other, "fast", "reliable", "--period-us", "20000", xml=SPDP)
    time.sleep(2)
    world.ip("-n", world.other, "link", "set", "eth0", "down")
    time.sleep(OUTAGE_S)
    world.ip("-n", world.other, "link", "set", "eth0", "up")
    world.ip("-n", world.other, "route", "replace", "224.0.0.0/4", "dev", "eth0")
    time.sleep(6)
    no_attack(world, fleet, "an outage of the network")

    # Programs that live for a moment, ten at a time.
    living = []
    for number in range(PROGRAMS):
        living.append(peer(world, f"short{number}", world.other, f"short{number % 7}", "reliable",
                           "--count", "5", "--period-us", "10000"))
        if len(living) == 10:
            for each in living:
                each.child.wait(30)
                world.processes.remove(each)
            living = []
    time.sleep(3)
    no_attack(world, fleet, f"{PROGRAMS} short-lived programs")
    check(not unwatched(world, fleet), f"not visible: {unwatched(world, fleet)}")
    fleet.wait_level("DEFAULT", 40)


SCENARIOS = [honest_robot_is_not_accused]


def main():
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    scenario = next(each for each in SCENARIOS if each.__name__ == sys.argv[2])
    directory = pathlib.Path(tempfile.mkdtemp(prefix="rips-honest."))

    def build_and_play(world):
        world.build()
        scenario(world)
    code = perform(scenario.__name__, build_and_play, World(sys.argv[1], directory))
    if code != 1:
        shutil.rmtree(directory, ignore_errors=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
