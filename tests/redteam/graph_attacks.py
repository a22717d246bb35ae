"""Attacks on the computation graph: processes on the robot's bus that fill it, so that nothing
more is seen on it. No certificate is needed for that."""

import time

from fleet import Failed, metrics
from guarded import ATTACK_S, check, quick, scenario

# Two more than this robot needs; a flood of a few hundred writers then fills the graph as one of
# 17,000 fills that of the default limits.
ENDPOINTS = 400
OF_ONE = 150
SOFT_HOLD_S = 5

# `ignore`: an undecided rule does not fire, so what fires was decided on what the graph shows.
RULES = """
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules Graph:
  second_driver:
    topicpublishercount("/cmd_vel", 2, 1000000) && CurrLevel < COMPROMISED ?
      alert("a second driver", "critical") => trigger(COMPROMISED);
rules External:
  calm: CurrLevel == ALERT ? trigger(DEFAULT);
  others: false ? trigger(ALERT), trigger(HALT);
"""


def arm(fleet, on_open):
    fleet.write("bundles/counting/counting.rul", RULES)
    fleet.write("bundles/counting/manifest.yaml", f"""name: counting
rules: [counting.rul]
levels: [DEFAULT, ALERT, COMPROMISED, HALT]
soft_hold: {SOFT_HOLD_S}s
on_inspection_error: {on_open}
""")
    fleet.bundle = "counting"
    fleet.sensor_options += (f"graph_limits: {{endpoints: {ENDPOINTS}, "
                             f"endpoints_per_participant: {OF_ONE}}}\n")
    fleet.arm()


def flood(fleet, processes, writers, *options):
    """Processes that make many writers each; returns when all of those are there."""
    flooders = [fleet.start(f"flood-{i}", fleet.bin / "robot_sim", "intruder", "--domain",
                            fleet.domain, "--mode", "flood", "--writers", writers, "--node",
                            f"/flood_{i}", *options) for i in range(processes)]
    for flooder in flooders:
        flooder.wait_for(lambda line: '"event":"flooded"' in line, 60, "the flood")
    return flooders


def texts(fleet):
    return [a["text"] for a in fleet.alerts()]


def wait_alert(fleet, part, seconds):
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        found = [a for a in fleet.alerts() if part in a["text"]]
        if found:
            return found[0]
        time.sleep(0.2)
    raise Failed(f"no alert says `{part}`: {texts(fleet)}")


def wait_decided(fleet, level, seconds):
    deadline = time.monotonic() + seconds
    while fleet.level()["decided_level"] != level:
        if time.monotonic() > deadline:
            raise Failed(f"not {level}, but {fleet.level()}; {texts(fleet)}")
        time.sleep(0.1)


def began(fleet):
    return [a for a in fleet.alerts() if "hit a limit (" in a["text"]]


@quick
def writers_that_fill_the_graph(fleet):
    """Four processes fill the graph; then one more drives. Its endpoint is kept, since a rule names
    the topic; no level sinks meanwhile, and when the flood is over the graph is judged whole."""
    arm(fleet, "ignore")
    flooders = flood(fleet, 4, 500)
    alert = wait_alert(fleet, "hit a limit (", 20)
    check(alert["severity"] == "critical", f"not critical: {alert}")
    check("node /flood_" in alert["text"] and "pid " in alert["text"] and
          "left out" in alert["text"], f"it does not name the flood: {alert}")
    wait_alert(fleet, "endpoints of the graph; 512 more", 5)

    fleet.ripsctl("level", "raise", "r1", "--to", "ALERT", "--reason", "drill")
    wait_decided(fleet, "ALERT", 5)
    time.sleep(SOFT_HOLD_S + 3)
    status = fleet.level()
    check(status["decided_level"] == "ALERT", f"a soft level sank: {status}")
    check(any("graph truncated" in text for text in status["degraded"]), f"calm: {status}")
    coverage = fleet.ripsctl("robot", "coverage", "r1", check=False)[1]
    check("graph truncated" in coverage, f"coverage does not say so: {coverage}")

    rogue = fleet.start_intruder("rogue-cmd-vel", "--node", "/rogue")
    wait_decided(fleet, "COMPROMISED", 10)
    second = wait_alert(fleet, "a second driver", 2)
    check("graph truncated" not in second["event"], f"it was not decided: {second}")
    check(len(began(fleet)) == 1, f"said more than once: {began(fleet)}")

    for process in [rogue, *flooders]:
        process.kill()
    wait_alert(fleet, "is whole again", 40)
    check(not any("graph truncated" in text for text in fleet.level()["degraded"]),
          f"still truncated: {fleet.level()}")
    counted = metrics(fleet.server)
    check(counted["rips_graph_truncations_total"] == 1 and counted["rips_graph_left_out"] == 0,
          f"counted otherwise: {counted}")
    fleet.bounded()


@quick
def a_count_in_a_full_graph_is_undecided(fleet):
    """As bundles have it by default, a rule fires that what was left out might make true."""
    arm(fleet, "match")
    flooders = flood(fleet, 4, 500, "--anonymous")
    wait_decided(fleet, "COMPROMISED", 20)
    alert = wait_alert(fleet, "a second driver", 2)
    check("graph truncated" in alert["event"], f"it does not say why: {alert}")
    for flooder in flooders:
        flooder.kill()
    fleet.bounded()


@scenario
def replies_that_fill_nothing(fleet):
    """Reply sides of services are in no graph. They took the place of what is, in a graph that
    looked whole."""
    arm(fleet, "ignore")
    flood(fleet, 4, 500, "--replies")
    fleet.start_intruder("rogue-cmd-vel", "--node", "/rogue")
    wait_decided(fleet, "COMPROMISED", 10)
    time.sleep(ATTACK_S)
    check(not began(fleet), f"nothing of the graph was left out: {began(fleet)}")
    fleet.bounded()
