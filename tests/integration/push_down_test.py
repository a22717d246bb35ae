#!/usr/bin/env python3
"""Two robots whose sensors watch the same traffic: of one the server asks only what its rules need,
of the other everything. What comes out of the rules is the same.

  push_down_test.py               names of the scenarios
  push_down_test.py BINARIES NAME runs one
"""
import json
import sys
import time

import fleet_test
from fleet_test import check, metrics

RULES = """
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
vars:
  a int = 0;
  c int = 0;
rules Msg:
  count_a: topicin("/load/a") ? set(a, a + 1);
  all_a: topicin("/load/a") && a == 600 ? alert("600 on a") => trigger(ALERT);
  all_b: topicmatches("^/load/b") && msgcount(60000, 300, 300) ? alert("300 on b");
  sender_b: topicmatches("^/load/b") && sendercount(60000, 300, 300) ? alert("300 of one sender");
  count_c: topicin("/load/c") && payload("x.yar") ? set(c, c + 1);
  all_c: topicin("/load/c") && c == 40 ? alert("40 on c hold what is looked for");
  stranger: topicin("/load/a") && !publishersinclude("/load_a") ? alert("a stranger on a");
rules Graph:
  unused: false ? trigger(COMPROMISED), trigger(HALT);
"""
# May be true of any topic as far as anybody can know beforehand, and never is.
EVERYTHING = """rules Msg:
  everything: msgcount(1000, 1000000, 2000000) ? alert("never");
"""
SENT = {"a": 600, "b": 300, "c": 40}
NOISE = 500


def wait_until(what, done, so_far=lambda: "", seconds=40):
    deadline = time.monotonic() + seconds
    while not done():
        if time.monotonic() >= deadline:
            check(False, f"{what}: not within {seconds} s; {so_far()}")
        time.sleep(0.1)


def write_bundle(fleet, name, rules):
    fleet.write(f"bundles/{name}/manifest.yaml",
                f"name: {name}\nrules: [r.rul]\nyara: [x.yar]\n"
                "levels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
    fleet.write(f"bundles/{name}/r.rul", rules)
    fleet.write(f"bundles/{name}/x.yar", 'rule x { strings: $x = "xxxxxxxx" condition: $x }\n')


def start_sensors(fleet):
    """The sensors of r1, narrow, and of r2, wide, when they watch what they are asked to."""
    fleet.mint("sensor", "r2", "base")
    fleet.write("robots.yaml", "robots:\n" + "".join(
        f"  - {{id: {robot}, bundle: {bundle}, sensors: [{{host: base, primary: true}}], "
        "actuators: []}\n" for robot, bundle in (("r1", "narrow"), ("r2", "wide"))))
    fleet.server = fleet.start_server()
    narrow = fleet.start_agent("sensor")
    text = (fleet.dir / "sensor.yaml").read_text()
    text = text.replace("robot: r1", "robot: r2").replace(f"{fleet.dir}/sensor\n",
                                                          f"{fleet.dir}/sensor2\n")
    config = fleet.write("sensor2.yaml", text.replace("/sensor/r1/", "/sensor/r2/"))
    wide = fleet.start("sensor2", fleet.bin / "rips-sensor", "--config", config)
    for robot in ("r1", "r2"):
        wait_until(f"the sensor of {robot} watches as it is asked", lambda robot=robot: all(
            sensor["in_use"] for sensor in fleet.query("robot", "interest", robot)["sensors"]))
    return narrow, wide


def publish(fleet, name, topic, count, readers):
    return fleet.start(f"load_{name}", fleet.bin / "robot_sim", "publish", "--domain",
                       fleet.domain, "--node", f"/load_{name}", "--topic", topic, "--rate", 200,
                       "--count", count, "--readers", readers)


def push_down_changes_no_verdict(fleet):
    write_bundle(fleet, "narrow", RULES)
    write_bundle(fleet, "wide", RULES + EVERYTHING)
    fleet.prepare()
    narrow, wide = start_sensors(fleet)

    loads = [publish(fleet, name, f"/load/{name}", count, 2) for name, count in SENT.items()]
    loads.append(publish(fleet, "noise", "/noise", NOISE, 1))
    for load in loads:
        load.wait_for(lambda line: '"published"' in line, 60, "everything is published")

    expected = sorted([("all_a", "600 on a"), ("all_b", "300 on b"),
                       ("all_c", "40 on c hold what is looked for"),
                       ("sender_b", "300 of one sender")])

    def verdicts(robot):
        alerts = fleet.query("alert", "list", robot, "--limit", "1000")["alerts"]
        return sorted((a["rule"], a["text"]) for a in alerts if a["rule"] != "(rips)")

    for robot in ("r1", "r2"):
        wait_until(f"the rules of {robot} have judged",
                   lambda robot=robot: len(verdicts(robot)) >= len(expected),
                   lambda robot=robot: f"so far: {verdicts(robot)}")
        check(verdicts(robot) == expected, f"{robot}: {verdicts(robot)}")
        level = fleet.query("level", "show", robot)["status"]["decided_level"]
        check(level == "ALERT", f"{robot} is at {level}")
    samples = {name: metrics(sensor)["rips_sensor_samples_total"]
               for name, sensor in (("narrow", narrow), ("wide", wide))}
    wanted = sum(SENT.values())
    check(samples["narrow"] == wanted, f"{samples}: {wanted} messages were needed")
    check(samples["wide"] >= wanted + NOISE, f"{samples}: the wide one did not see everything")
    rows = fleet.query("robot", "interest", "r1")
    check(rows["rules"][-1]["depth"] == "nothing", json.dumps(rows))


fleet_test.SCENARIOS = [push_down_changes_no_verdict]

if __name__ == "__main__":
    sys.exit(fleet_test.main())
