"""Attacks on what a level is read back from: a process on the robot's bus serves the robot's parts
beside it. It holds no key."""

import time

from fleet import Failed, Fleet, check, eventually
from guarded import quick, scenario

WATCHED_S = 6
RULES = """
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules External:
  others: false ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);
"""


def arm(fleet):
    fleet.write("bundles/quiet/quiet.rul", RULES)
    fleet.write("bundles/quiet/manifest.yaml", """name: quiet
rules: [quiet.rul]
levels: [DEFAULT, ALERT, COMPROMISED, HALT]
""")
    fleet.bundle = "quiet"
    Fleet.arm(fleet)
    drive = fleet.start("drive", *fleet.robot_sim("probe"), "--topic", "/cmd_vel", "--type",
                        "geometry_msgs/msg/Twist", "--window-ms", "250", "--node", "/watcher")
    drive.wait_for(lambda line: '"event":"rate"' in line and '"samples":0,' not in line, 10,
                   "the robot drives")
    return drive


def start_rival(fleet, *options):
    rival = fleet.start("rival", fleet.bin / "robot_sim", "rival", "--domain", str(fleet.domain),
                        "--interface", fleet.interface, "--smh", fleet.smh, *options)
    rival.wait_for(lambda line: '"event":"rival"' in line, 15, "the rival serves")
    return rival


def drives(drive, windows=2):
    """Whether the robot drives in the next windows of a quarter of a second."""
    seen = len(drive.lines)
    deadline = time.monotonic() + 5
    while time.monotonic() < deadline:
        rates = [line for _, line in drive.lines[seen:] if '"event":"rate"' in line]
        if len(rates) > windows:  # the first one had begun before
            return any('"samples":0,' not in line for line in rates[1:])
        time.sleep(0.05)
    raise Failed("the rate of /cmd_vel is not measured")


def raise_to_compromised(fleet):
    fleet.ripsctl("level", "raise", "r1", "--to", "COMPROMISED", "--reason", "drill")


def never_verified_while_it_drives(fleet, drive, seconds):
    """The stages seen, and whether the robot stopped."""
    deadline = time.monotonic() + seconds
    stages = set()
    while time.monotonic() < deadline:
        status = fleet.level()
        stages.add(status["stage"])
        if status["stage"] == "verified" and status["effective_level"] == "COMPROMISED":
            check(not drives(drive), "COMPROMISED is verified and /cmd_vel goes on")
        time.sleep(0.1)
    return stages, not drives(drive)


def told(fleet):
    """The rival is a finding, and the actuator says why the level is not reached."""
    eventually(lambda: any("rival_server" in f"{a['event']} {a['text']}" for a in fleet.alerts()),
               5, "the finding rival_server")
    fleet.actuator.wait_for(lambda line: "not reached" in line and "servers offer" in line, 1,
                            "the actuator says why")


def recovers(fleet, drive):
    fleet.wait_level("COMPROMISED", 25)
    check(not drives(drive), "COMPROMISED is verified and /cmd_vel goes on")


@quick
def a_rival_serves_the_parts(fleet):
    """It keeps what the actuator sends from the robot's own servers, by forged heartbeats without
    end, and carries out each order itself. The level is not verified while the rival is there, and
    is when it has gone."""
    drive = arm(fleet)
    rival = start_rival(fleet, "--deafen-always")
    raise_to_compromised(fleet)
    stages, _ = never_verified_while_it_drives(fleet, drive, WATCHED_S)
    check("verified" not in stages, f"stages: {stages}")
    told(fleet)
    rival.kill()
    recovers(fleet, drive)


@scenario
def a_rival_serves_the_parts_and_deafens_once(fleet):
    """As above, with one forged heartbeat of each client: the robot hears the orders that follow,
    and stops, although the level is not verified beside the rival."""
    drive = arm(fleet)
    rival = start_rival(fleet, "--deafen")
    raise_to_compromised(fleet)
    stages, stopped = never_verified_while_it_drives(fleet, drive, WATCHED_S)
    check("verified" not in stages, f"stages: {stages}")
    check(stopped, "the robot did not hear the order")
    told(fleet)
    rival.kill()
    recovers(fleet, drive)
