"""One robot, its agents and the policy server, as processes: what goes wrong must not lower a level.

    fleet_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import json
import os
import pathlib
import random
import re
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
import zlib

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import (  # noqa: E402
    LEVELS, SOURCE, Failed, Fleet, Skipped, check, cpu_seconds, metrics, page, perform)


def decided(fleet):
    return [each for each in fleet.history() if not each["refused"]]


def may_lower(*steps):
    """The scenario asks for these lowerings, (cause, from, to), each once."""
    def decorate(scenario):
        scenario.lowers = steps
        return scenario
    return decorate


def decision_id_of(record):
    return tuple(int(part) for part in record["decision_id"].split("."))


def never_lower(fleet, asked=()):
    """No decision in the robot's history went down, but for the steps asked for; none is missing
    between two others; and the robot's level is what was decided last."""
    decisions = decided(fleet)
    status = fleet.level()  # after the history: can only be newer
    check(decisions, "no decision is recorded")
    left = list(asked)
    for former, each in zip([None] + decisions, decisions):
        # `operator alice (URI serial NUMBER)`: the name is enough here.
        step = (each["cause"].partition(" (spiffe://")[0], each["from"], each["to"])
        if LEVELS.index(each["to"]) < LEVELS.index(each["from"]):
            check(step in left, f"the level went down: {step}, {each['reason']}")
            left.remove(step)
        if former is None:
            continue
        check(each["from"] == former["to"],
              f"from {former['to']} to {each['from']} without a decision, before {each}")
        check(decision_id_of(each) > decision_id_of(former), f"{each} is not later than {former}")
    check(not left, f"asked for and not done: {left}")
    last = decisions[-1]
    if decision_id_of(status) == decision_id_of(last):
        check(status["decided_level"] == last["to"], f"{status} is not as decided: {last}")
    check(decision_id_of(status) >= decision_id_of(last), f"{status} is older than {last}")


def compromise(fleet):
    driver = fleet.start_intruder("rogue-cmd-vel")
    fleet.wait_level("COMPROMISED", 20)
    return driver


def applied(fleet):
    """How often the actuator entered a level."""
    return sum(" applying level " in text for _, text in fleet.actuator.lines)


# ------------------------------------------------------------------------------------ scenarios


def kill_server_while_compromised(fleet):
    fleet.arm()
    compromise(fleet)
    before = decided(fleet)
    entered = applied(fleet)
    watch = fleet.start("watch", *fleet.ripsctl_args("alert", "watch", "--after", "0"))
    watch.wait_for(lambda line: "rogue_driver" in line, 10, "the watch shows what is stored")
    fleet.server.kill(signal.SIGKILL)
    check(fleet.mode()["mode"] == "COMPROMISED", "the robot left its mode with the server")
    time.sleep(3)  # the watch has tried in vain

    fleet.server = fleet.start_server()
    fleet.ripsctl("rules", "resume", "r1", "--reason", "is the watch back?")
    watch.wait_for(lambda line: "is the watch back?" in line, 20, "the watch goes on")

    fleet.wait_level("COMPROMISED", 20)
    after = decided(fleet)
    check([d["decision_id"] for d in after] == [d["decision_id"] for d in before],
          f"decisions changed from {before} to {after}")
    check(applied(fleet) == entered, "a level was entered again")
    receipts = fleet.query("robot", "receipts", "r1")["receipts"]
    check(any(each["command"] == "level COMPROMISED" for each in receipts),
          f"what the actuator answered before the kill is not known any more: {receipts}")
    time.sleep(8)  # longer than soft_hold
    check(fleet.level()["decided_level"] == "COMPROMISED", "the level sank after the restart")
    rogue = [a for a in fleet.alerts() if a["rule"] == "rogue_driver"]
    check(len(rogue) == 1, f"the rule alerted {len(rogue)} times")


def explained_when_the_driver_has_gone(fleet):
    """Why the robot stopped and who it was is still known when the driver has left, the server was
    started anew, and only a viewer asks."""
    fleet.arm()
    driver = compromise(fleet)
    alert = next(a for a in fleet.alerts() if a["rule"] == "rogue_driver")
    check(any(s["name"] == "/intruder" and s["role"].startswith("publishes /cmd_vel")
              and s["guid"] and s["pid"] for s in alert["subjects"]),
          f"the alert does not say who it was: {alert['subjects']}")
    driver.kill()
    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()
    fleet.wait_level("COMPROMISED", 20)

    _, text, _ = fleet.ripsctl("explain", "r1")
    for part in ("went from", "to COMPROMISED", "rule rogue_driver, warehouse.rul:53",
                 "message on /cmd_vel from", '!publishers("/navigator")',
                 'publishers("/navigator")  ', "false", "/intruder", "publishes /cmd_vel",
                 "Now: r1 is at COMPROMISED"):
        check(part in text, f"`{part}` is missing in:\n{text}")
    by_id = fleet.ripsctl("explain", alert["id"][:8])[1]
    check("critical alert" in by_id and "-> COMPROMISED" in by_id,
          f"the alert does not say what came of it:\n{by_id}")
    code, _, error = fleet.ripsctl("explain", "r1@1.999", check=False)
    check(code == 1 and "1.999" in error, f"{code} {error}")


def alerts_replay_to_the_same_verdict(fleet):
    """What led to each grave alert is saved with it: replayed, the same rules raise the same alert;
    also after the server died and was started anew. Only operators get it."""
    fleet.arm()
    fleet.mint("operator", "viewer", "vera")
    time.sleep(3)
    stranger = fleet.start_intruder("unknown-node")
    fleet.wait_level("ALERT", 20)
    time.sleep(6)  # a recording of its own
    compromise(fleet)
    grave = [a for a in fleet.alerts() if a["severity"] in ("high", "critical")]
    by_rule = {a["rule"]: a for a in grave}
    check({"stranger_came", "rogue_driver"} <= by_rule.keys(), f"{by_rule.keys()}")
    until(fleet, 10, "the recordings are saved", lambda: all(
        fleet.ripsctl("alert", "recording", a["id"], "--out", str(fleet.dir / "seen.rips"),
                      "--force", check=False)[0] == 0 for a in grave))
    stranger.kill()
    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()
    fleet.wait_level("COMPROMISED", 20)

    for rule, level in (("stranger_came", "ALERT"), ("rogue_driver", "COMPROMISED")):
        result, path = fleet.replay(by_rule[rule])
        check(any(a["id"] == by_rule[rule]["id"] and a["event"] is not None
                  for a in result["recorded"]),
              f"{rule} does not fire in its replay: {result['recorded']}, {path}")
        check(any(t["to"] == level and not t.get("refused") for t in result["transitions"]),
              f"{rule} leads to no {level} in its replay: {result['transitions']}")
    code, _, error = ripsctl_as(fleet, "viewer", "vera", "alert", "recording", grave[0]["id"],
                                "--out", str(fleet.dir / "vera.rips"))
    check(code == 1 and "needs the role `operator`" in error, f"{code} {error}")
    code, _, error = fleet.ripsctl("alert", "recording", "0" * 32, "--out",
                                   str(fleet.dir / "none.rips"), check=False)
    check(code == 1 and "its id is wrong" in error, f"{code} {error}")
    mild = next((a for a in fleet.alerts() if a["severity"] == "info"), None)
    if mild:
        check(fleet.ripsctl("alert", "recording", mild["id"], "--out", str(fleet.dir / "no.rips"),
                            check=False)[0] == 1, "a recording of an alert of severity info")


@may_lower(("operator alice", "COMPROMISED", "ALERT"))
def two_persons_release_a_robot(fleet):
    """Where the bundle wants two persons, one operator alone lowers nothing, whatever role the
    certificate has; the second lowers what the first asked for, and accepts what has changed."""
    fleet.bundle = "two"
    fleet.write("bundles/two/warehouse.rul", (SOURCE / "rules/warehouse/warehouse.rul").read_text())
    fleet.write("bundles/two/manifest.yaml",
                "name: two\nrules: [warehouse.rul]\nlevels: [DEFAULT, ALERT, COMPROMISED, HALT]\n"
                "two_person: [COMPROMISED, HALT]\n")
    fleet.arm()
    for role, name in (("admin", "alice"), ("viewer", "vera"), ("operator", "bob")):
        fleet.mint("operator", role, name)
    driver = compromise(fleet)
    driver.kill()
    until(fleet, 20, "the driver has gone",
          lambda: "/intruder" not in fleet.ripsctl("robot", "graph", "r1")[1])

    def ask():
        code, out, error = fleet.ripsctl("--output", "json", "level", "lower", "r1", "--to",
                                         "ALERT", "--reason", "the aisle is clear", check=False)
        check(code == 1, f"one operator asked and got {code}: {out}{error}")
        answer = json.loads(out)
        check(answer["needs_approval"] and answer["decided_level"] == "COMPROMISED", f"{answer}")
        return answer["pending_approval_id"]

    def approve(role, name, lowering):
        return ripsctl_as(fleet, role, name, "level", "approve", "r1", lowering, "--reason",
                          "seen on the camera", "--wait")

    first = ask()
    shown = fleet.ripsctl("level", "show", "r1")[1]
    check(first[:8] in shown and "COMPROMISED (two persons)" in shown, shown)
    check("1 lowering waits for a second operator" in fleet.ripsctl("robot", "list")[1],
          "the list of robots does not say that a lowering waits")
    for role, name, why in (("operator", "alice", "who asks for a lowering cannot approve it"),
                            ("admin", "alice", "who asks for a lowering cannot approve it"),
                            ("viewer", "vera", "this needs the role `operator`")):
        code, out, error = approve(role, name, first)
        check(code == 1 and why in error, f"{role} {name}: {code} {out} {error}")
    until(fleet, 20, "an alert for the viewer who approves", lambda: any(
        "operator vera" in a["text"] and "was refused to move r1 to ALERT" in a["text"]
        for a in fleet.alerts()))

    visitor = fleet.start_intruder("unknown-node", "--node", "/visitor")
    until(fleet, 20, "what has changed is shown",
          lambda: "/visitor came" in fleet.ripsctl("level", "show", "r1")[1])
    code, _, error = approve("operator", "bob", first)
    check(code == 1 and "node /visitor came" in error and "--accept-changes" in error,
          f"{code} {error}")
    visitor.kill()
    until(fleet, 20, "the visitor has gone",
          lambda: "/visitor" not in fleet.ripsctl("robot", "graph", "r1")[1])

    second = ask()
    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()
    fleet.wait_level("COMPROMISED", 20)
    code, _, error = approve("operator", "bob", second)
    check(code == 1 and "no lowering of r1 waits" in error, f"{code} {error}")

    code, out, error = approve("operator", "bob", ask())
    check(code == 0 and "r1 is at ALERT: every actuator has read it back" in out,
          f"{code} {out} {error}")
    last = fleet.history()[-1]
    check(last["cause"].startswith("operator alice ") and ", approved by bob (" in last["cause"]
          and last["reason"] == "the aisle is clear; approved: seen on the camera", f"{last}")
    approvals = [(r["actor"].rpartition("/")[2].split()[0], r["outcome"])
                 for r in audited(fleet) if r["action"] == "Approve"]
    check(("alice", "admitted") in approvals and approvals[-1] == ("bob", "admitted")
          and any(who == "alice" and "cannot approve it" in outcome for who, outcome in approvals)
          and any(who == "vera" and "needs the role" in outcome for who, outcome in approvals),
          f"the audit log does not say who approved, and what came of it: {approvals}")


def audited(fleet):
    """Records of the audit log, which is whole."""
    directory = str(fleet.dir / "server/audit")
    fleet.ripsctl("audit", "verify", directory)
    return [json.loads(line) for line in fleet.ripsctl("audit", "export", directory)[1].splitlines()]


@may_lower(("operator alice", "COMPROMISED", "DEFAULT"))
def audit_log_outlives_a_kill(fleet):
    """Who raised, lowered and was refused is in the audit log, also when the server was killed;
    what a hand changes or takes away afterwards is found."""
    fleet.arm()
    driver = compromise(fleet)
    driver.kill()
    fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--reason",
                  "checked the floor")
    directory = str(fleet.dir / "server/audit")
    head = json.loads(fleet.ripsctl("audit", "verify", directory, "--output", "json")[1])["head"]
    yesterday = str(fleet.dir / "yesterday")
    shutil.copytree(directory, yesterday)
    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()

    records = audited(fleet)
    decisions = [(r["from"], r["to"], r["actor"].split()[0]) for r in records
                 if r["kind"] == "decision"]
    check(("COMPROMISED", "DEFAULT", "operator") in decisions
          and any(to == "COMPROMISED" for _, to, _ in decisions), f"decisions: {decisions}")
    call = next(r for r in records if r["action"] == "DeEscalate")
    check("/operator/" in call["actor"] and "checked the floor" in call["text"]
          and call["outcome"] == "admitted", f"call: {call}")
    check(any("opened by a server's start" in r["text"] for r in records), "no start on record")
    fleet.ripsctl("audit", "verify", directory, "--head", head)

    later = json.loads(fleet.ripsctl("audit", "verify", directory, "--output", "json")[1])["head"]
    code, _, error = fleet.ripsctl("audit", "verify", yesterday, "--head", later, check=False)
    check(code == 1 and "rolled back" in error, f"{code} {error}")
    segment = pathlib.Path(yesterday) / "00000001.audit"
    content = bytearray(segment.read_bytes())
    content[len(content) // 2] ^= 1
    segment.write_bytes(content)
    code, _, error = fleet.ripsctl("audit", "verify", yesterday, check=False)
    check(code == 1 and "altered" in error, f"{code} {error}")


def kept_audit_head(fleet):
    """(sequence, hash) of the audit log, as the actuator keeps it on its host; None = none yet."""
    path = fleet.dir / "actuator/audit_head"
    if not path.exists():
        return None
    values = dict(line.split(" ", 1) for line in path.read_text().splitlines())
    return int(values["sequence"]), values["hash"]


def audit_log_put_back_is_contradicted_by_the_robot(fleet):
    """Restarts and kills of either end are no trouble; an audit log that was put back to an older
    state is contradicted by what the actuator was shown, and an auditor can prove it."""
    fleet.arm()
    until(fleet, 20, "the actuator keeps no head", lambda: kept_audit_head(fleet))
    fleet.server.kill(signal.SIGKILL)
    directory = fleet.dir / "server/audit"
    yesterday = fleet.dir / "yesterday"
    shutil.copytree(directory, yesterday)
    fleet.server = fleet.start_server()
    fleet.actuator.kill()
    fleet.actuator = fleet.start_agent("actuator")
    before = kept_audit_head(fleet)
    compromise(fleet).kill()
    until(fleet, 30, "the actuator is not shown the raise", lambda: kept_audit_head(fleet) > before)
    check(not alerted(fleet, "audit log"), f"whole, and yet: {fleet.alerts()}")

    fleet.server.kill()
    shutil.rmtree(directory)
    shutil.copytree(yesterday, directory)
    fleet.server = fleet.start_server()
    until(fleet, 40, "the log is not contradicted",
          lambda: alerted(fleet, "was shown record", "signed by the key", "put back"))
    alert = next(a for a in fleet.alerts() if "was shown record" in a["text"])
    check(alert["severity"] == "critical" and alert["robot"] == "r1", f"{alert}")
    fleet.actuator.wait_for(lambda line: "audit log contradicted" in line, 20, "the robot's own log")
    check('rips_audit_heads_total{verdict="contradicted"} 1' in
          page(fleet.server, "metrics").splitlines(), "the metrics do not say so")
    head = re.search(r"--head (\d+:[0-9a-f]{64})`", alert["text"])[1]
    check(int(head.partition(":")[0]) >= kept_audit_head(fleet)[0], f"{head} is not what it keeps")
    code, _, error = fleet.ripsctl("audit", "verify", str(directory), "--head", head, check=False)
    check(code == 1 and "rolled back" in error, f"{code} {error}")
    check(any("was shown record" in r["text"] for r in audited(fleet)), "the log itself is silent")
    check(fleet.level()["decided_level"] == "COMPROMISED", "the level went down")


def kill_server_at_the_moment_of_a_raise(fleet):
    """Raises are commanded while they are recorded: whatever the store lost, the robot's own decision id
    brings back."""
    fleet.arm()
    driver = fleet.start_intruder("rogue-cmd-vel")
    fleet.actuator.wait_for(
        lambda line: " receipt " in line and "stage=acknowledged" in line and "decision_id=1.1 " not in line,
        20, "a raise arrives")
    fleet.server.kill(signal.SIGKILL)

    fleet.server = fleet.start_server()

    fleet.wait_level("COMPROMISED", 30)
    driver.kill()
    time.sleep(7)
    check(fleet.level()["decided_level"] == "COMPROMISED", "the level sank")


@may_lower(("rule calm", "ALERT", "DEFAULT"))
def kill_sensor_in_the_story(fleet):
    fleet.arm()
    spy = fleet.start_intruder("unknown-node")
    fleet.wait_level("ALERT", 20)
    fleet.sensor.kill(signal.SIGKILL)
    spy.kill()  # nobody sees it leave

    time.sleep(8)

    never_lower(fleet)
    check(fleet.level()["decided_level"] == "ALERT", "the level has changed")
    check(any("sensor base is lost" in a["text"] for a in fleet.alerts()), "its loss is not told")
    code, _, error = fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--reason", "try",
                                   check=False)
    check(code == 1 and "sensor base is not connected" in error,
          f"a blind lowering was not refused: {code} {error}")
    fleet.sensor = fleet.start_agent("sensor")
    fleet.wait_level("DEFAULT", 30)  # seen again, quiet, and by rule
    check(decided(fleet)[-1]["cause"] == "rule calm", "not lowered by the rule")


@may_lower(("rule calm", "ALERT", "DEFAULT"))
def sensor_on_a_wrong_domain(fleet):
    """It sees nobody, which is no proof of calm: not healthy, and nothing is lowered."""
    right = fleet.write_agent_configs
    wrong = fleet.domain % 90 + 10
    log = fleet.dir / "ids/eve.json"

    def with_wrong_domain():
        right()
        config = fleet.dir / "sensor.yaml"
        text = config.read_text().replace(f"domain: {fleet.domain},", f"domain: {wrong},")
        config.write_text(f"{text}ids: [{{format: eve, path: {log}}}]\n")
    fleet.write_agent_configs = with_wrong_domain
    fleet.prepare()
    fleet.robot = fleet.start_robot()
    fleet.server = fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")
    fleet.actuator = fleet.start_agent("actuator")
    nobody = (f"sensor base sees no ROS node on domain {wrong}; "
              "are dds.domain and dds.interface right?")
    no_log = f"sensor base: IDS log (eve): cannot open `{log}`: No such file or directory"

    def wait_degraded(*texts):
        deadline = time.monotonic() + 30
        while not all(text in fleet.level()["degraded"] for text in texts):
            if time.monotonic() > deadline:
                raise Failed(f"degraded by {fleet.level()['degraded']}, not by {texts}")
            time.sleep(0.1)
    wait_degraded(nobody, no_log)
    code, out, _ = fleet.ripsctl("robot", "coverage", "r1", check=False)
    check(code == 1 and f"BLIND: {nobody}\n" in out and f"BLIND: {no_log}\n" in out,
          f"coverage: {code}, {out}")
    check(nobody in fleet.ripsctl("robot", "list")[1], "the list of robots does not say so")

    fleet.ripsctl("level", "raise", "r1", "--to", "ALERT", "--reason", "to see it come down")
    fleet.wait_level("ALERT", 20)
    time.sleep(8)  # longer than soft_hold
    check(fleet.level()["decided_level"] == "ALERT", "a blind sensor lowered the level")
    refused = [each for each in fleet.history() if each["refused"]]
    check(any("blind" in each["reason"] and nobody in each["reason"] for each in refused),
          f"the lowering was not refused as blind: {refused}")
    check(fleet.sensor.kill() == 0, "the sensor does not end well")

    log.parent.mkdir()
    log.touch()
    fleet.write_agent_configs = right
    fleet.sensor_options = f"ids: [{{format: eve, path: {log}}}]\n"
    fleet.sensor = fleet.start_agent("sensor")
    fleet.wait_level("DEFAULT", 40)
    check(decided(fleet)[-1]["cause"] == "rule calm", "not lowered by the rule")
    check(not fleet.level()["degraded"], f"degraded by {fleet.level()['degraded']}")
    code, out, _ = fleet.ripsctl("robot", "coverage", "r1", check=False)
    check("BLIND" not in out, f"coverage: {code}, {out}")
    seen = fleet.query("robot", "coverage", "r1", check=False)
    # In its first minute the sensor does not say that it has told all findings.
    check(seen["complete"] or seen["findings_not_known_because"] and not seen["findings"]
          and not seen["graph_truncated"] and not seen["skipped_inspections"], f"coverage: {seen}")


def kill_actuator_while_compromised(fleet):
    fleet.arm()
    driver = compromise(fleet)
    before = decided(fleet)
    fleet.actuator.kill(signal.SIGKILL)
    check(fleet.mode()["mode"] == "COMPROMISED", "the robot left its mode")
    driver.kill()

    fleet.actuator = fleet.start_agent("actuator")

    fleet.actuator.wait_for(lambda line: "effective=COMPROMISED" in line, 10,
                            "the restarted actuator holds its level")
    fleet.wait_level("COMPROMISED", 20)
    check([d["decision_id"] for d in decided(fleet)] == [d["decision_id"] for d in before], "decisions changed")


@may_lower(("rule calm", "ALERT", "DEFAULT"))
def server_absent_at_agent_start(fleet):
    fleet.prepare()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        fleet.port = probe.getsockname()[1]
    fleet.robot = fleet.start_robot()
    fleet.sensor = fleet.start_agent("sensor", wait=False)
    fleet.actuator = fleet.start_agent("actuator", wait=False)
    fleet.actuator.wait_for(lambda line: "effective=ALERT verified=true" in line, 15,
                            "an actuator alone takes its fail-safe level")
    spy = fleet.start_intruder("unknown-node")
    time.sleep(2)

    fleet.server = fleet.start_server()

    fleet.wait_level("ALERT", 25)
    spy.kill()
    fleet.wait_level("DEFAULT", 30)


def lost_lease_raises_the_floor(fleet):
    fleet.arm()
    before = decided(fleet)
    fleet.server.kill(signal.SIGKILL)

    fleet.actuator.wait_for(lambda line: "effective=ALERT verified=true" in line and
                            "floor=ALERT" in line, 30, "the fail-safe level after the lease",
                            start=len(fleet.actuator.lines))
    check(fleet.mode()["mode"] == "ALERT", "the fail-safe mode was not read back")

    fleet.server = fleet.start_server()
    fleet.wait_level("DEFAULT", 40)
    check([d["decision_id"] for d in decided(fleet)] == [d["decision_id"] for d in before],
          "the floor became a decision")


def manager_that_lies(fleet):
    """It answers `success` and does nothing, and nobody else may order the nodes: failed, with an
    alert, and the decision stands."""
    fleet.mode_options = ", fallback: none"
    fleet.prepare()
    fleet.robot = fleet.start_robot("--manager", "lie")
    fleet.server = fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")
    fleet.actuator = fleet.start_agent("actuator")
    fleet.start_intruder("unknown-node")

    deadline = time.monotonic() + 60
    while fleet.level()["stage"] != "failed":
        check(time.monotonic() < deadline, f"not failed: {fleet.level()}")
        time.sleep(0.2)

    status = fleet.level()
    check(status["decided_level"] == "ALERT", f"the decision does not stand: {status}")
    alerts = [a for a in fleet.alerts() if "was not reached" in a["text"]]
    check(alerts and alerts[-1]["severity"] == "critical", "no critical alert")
    check("camera" in alerts[-1]["text"], f"the alert does not name the part: {alerts[-1]['text']}")
    check(fleet.mode()["mode"] == "__DEFAULT__", "the simulated manager did not lie")


def bad_discovery_messages(fleet):
    """Malformed, truncated and foreign ros_discovery_info: the graph stays right, nobody falls, and
    a claim on another's endpoints is told."""
    fleet.arm("--bad-discovery")
    fleet.robot.wait_for(lambda line: '"bad_discovery"' in line, 20, "bad messages are sent")
    time.sleep(1)

    graph = fleet.query("robot", "graph", "r1")

    names = [node["name"] for node in graph["nodes"]]
    check(names == ["/base", "/camera", "/lidar", "/navigator", "/rips", "/safety"],
          f"nodes are {names}")
    check(fleet.sensor.running, "the sensor has ended")
    check(fleet.level()["decided_level"] == "DEFAULT", "the level has changed")
    deadline = time.monotonic() + 20
    while not any("finding false_claim" in alert["text"] for alert in fleet.alerts()):
        check(time.monotonic() < deadline, f"the false claim is not told: {fleet.alerts()}")
        time.sleep(0.2)


HORN = """#!/bin/sh
cd PROGRAMS
echo "${RIPS_DRILL:-earnest}" >> horn.runs
[ -e slow ] || exit 0
touch begun
exec sleep 60
"""


def drill(fleet):
    """It says what would work and what would not; the level stays, and a raise goes first."""
    if os.geteuid() != 0:
        raise Skipped("programs of an allow-list must belong to root")
    programs = pathlib.Path(tempfile.mkdtemp(prefix="rips-test-", dir="/opt"))
    fleet.leftovers.append(programs)
    for name, text in (("horn", HORN), ("plain", "#!/bin/sh\n")):
        (programs / name).write_text(text.replace("PROGRAMS", str(programs)))
        (programs / name).chmod(0o755)
    fleet.programs = f"""programs:
  - {{name: horn, path: {programs}/horn, timeout: 12s, drill: true}}
  - {{name: plain, path: {programs}/plain}}
"""
    fleet.steps = {"COMPROMISED": ["{program: {name: horn}, timeout: 5s}"],
                   "HALT": ["{program: {name: plain}, timeout: 2s}"]}
    before = fleet.arm()
    decisions, entered = [each["decision_id"] for each in decided(fleet)], applied(fleet)

    # Whole: every level, what was done with each step, and nothing else.
    code, out, err = fleet.ripsctl("robot", "drill", "r1", check=False)
    check(code == 0, f"code {code}: {out}{err}")
    check(out.endswith("5 steps were only looked at: what it needs is there, but it was not carried "
                       "out\n6 of 6 steps work\n"), out)
    check([line.split()[0] for line in out.splitlines()[1:7]] ==
          ["DEFAULT", "ALERT", "COMPROMISED", "COMPROMISED", "HALT", "HALT"], out)
    check((programs / "horn.runs").read_text() == "1\n", "the horn was not run as a drill, once")
    after = fleet.level()
    for key in ("decided_level", "effective_level", "stage", "decision_id"):
        check(after[key] == before[key], f"{before} has become {after}")
    check(fleet.mode()["mode"] == "__DEFAULT__", "the robot's mode has changed")
    check(([each["decision_id"] for each in decided(fleet)], applied(fleet)) == (decisions, entered),
          "a level was entered")
    texts = [alert["text"] for alert in fleet.alerts()]
    check(any(re.fullmatch(r"drill by alice \(spiffe://.*\) is over: 6 of 6 steps work", text)
              for text in texts), texts)
    receipts = fleet.query("robot", "receipts", "r1", "--limit", "64")["receipts"]
    check([each["command"] for each in receipts[:4]] ==
          ["drill HALT", "drill COMPROMISED", "drill ALERT", "drill DEFAULT"], receipts)

    # A program that has gone.
    (programs / "plain").unlink()
    code, out, _ = fleet.ripsctl("robot", "drill", "r1", "--level", "HALT", check=False)
    check(code == 1 and out.splitlines()[-1].startswith(
        "1 of 2 steps work; 1 does not: program plain on base (HALT)"), f"code {code}: {out}")

    # A raise while the drill runs.
    (programs / "slow").touch()
    drilling = fleet.start("drill", *fleet.ripsctl_args("robot", "drill", "r1", "--level",
                                                        "COMPROMISED"))
    deadline = time.monotonic() + 30
    while not (programs / "begun").exists():
        check(time.monotonic() < deadline, "the drill does not begin")
        time.sleep(0.05)
    fleet.ripsctl("level", "raise", "r1", "--to", "ALERT", "--reason", "in the middle")
    fleet.wait_level("ALERT", 20)
    drilling.wait_for(lambda line: "superseded" in line, 20, "the drill is told to be superseded")
    check(drilling.child.wait(20) == 1, "a drill that was broken off counts as one that works")
    (programs / "slow").unlink()

    # A mode manager that is not there. The actuator tries to put the level back, which goes first.
    fleet.robot.kill()
    fleet.robot = fleet.start_robot("--manager", "absent")
    deadline = time.monotonic() + 90
    while True:
        code, out, err = fleet.ripsctl("robot", "drill", "r1", "--level", "DEFAULT", check=False)
        check(code == 1, f"code {code}: {out}{err}")
        if "no mode manager of `/safety` answers" in out:
            break
        check(time.monotonic() < deadline, f"the manager's absence is not told: {out}{err}")
        time.sleep(0.3)
    check("0 of 1 steps work; 1 does not: system_mode /safety=__DEFAULT__ on base (DEFAULT)" in out,
          out)


RULE_R = """
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
rules Graph:
  R: !nodesinclude("/camera", "/lidar", "/base", "/navigator", "/safety", "/rips") && CurrLevel < HALT ? {
    alert("info: rule R activated");
    exec("usb_alarm") !> alert("warning: usb_alarm failed");
    exec("siren") !> alert("warning: siren failed");
    exec("flood") => alert("flood was drained");
    trigger(HALT);
  }
  unused: false ? trigger(ALERT), trigger(COMPROMISED);
"""


def programs_that_misbehave(fleet):
    """The paper's rule R, with programs that hang, flood their output, and are not allowed."""
    fleet.bundle = "paper"
    fleet.write("bundles/paper/manifest.yaml",
                "name: paper\nrules: [r.rul]\nlevels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
    fleet.write("bundles/paper/r.rul", RULE_R)
    if os.geteuid() != 0:
        raise Skipped("programs of an allow-list must belong to root")
    # Every directory on the way must be root's alone, which /tmp is not.
    programs = pathlib.Path(tempfile.mkdtemp(prefix="rips-test-", dir="/opt"))
    fleet.leftovers.append(programs)
    for name, text in (("hang", "trap '' TERM\nsleep 600\n"),
                       ("flood", "head -c 3000000 /dev/zero\n")):
        path = programs / name
        path.write_text("#!/bin/sh\n" + text)
        path.chmod(0o755)
    fleet.programs = f"""programs:
  - {{name: usb_alarm, path: {programs}/hang, timeout: 1s}}
  - {{name: flood, path: {programs}/flood, timeout: 10s}}
"""
    fleet.arm()

    fleet.start_intruder("unknown-node")

    fleet.wait_level("HALT", 20)
    deadline = time.monotonic() + 20
    wanted = {"info: rule R activated", "warning: usb_alarm failed", "warning: siren failed",
              "flood was drained"}
    while not wanted <= {a["text"] for a in fleet.alerts()}:
        check(time.monotonic() < deadline,
              f"missing: {wanted - {a['text'] for a in fleet.alerts()}}")
        time.sleep(0.2)
    check(any("`siren`" in a["text"] and "not run" in a["text"] for a in fleet.alerts()),
          "a program that is not on the allow-list is not told")


def reload_of_a_broken_bundle(fleet):
    shutil.copytree(pathlib.Path(__file__).resolve().parents[2] / "rules/warehouse",
                    fleet.dir / "bundles/warehouse")
    fleet.arm()
    bundle = fleet.level()["bundle"]
    rules = fleet.dir / "bundles/warehouse/warehouse.rul"
    good = rules.read_text()
    rules.write_text(good + "\nrules Graph:\n  broken: nodecount(1) ? alert(\"x\");\n")

    fleet.server.child.send_signal(signal.SIGHUP)

    fleet.server.wait_for(lambda line: "bundle refused" in line, 10, "the refusal is logged")
    check(fleet.level()["bundle"] == bundle, "the old bundle is not in force")
    rules.write_text(good + "\n# a comment\n")
    fleet.server.child.send_signal(signal.SIGHUP)
    deadline = time.monotonic() + 10
    while fleet.level()["bundle"] == bundle:
        check(time.monotonic() < deadline, "the new bundle is not in force")
        time.sleep(0.1)
    compromise(fleet)


def metrics_follow_the_level_and_the_inventory(fleet):
    fleet.arm()

    def wait_for(lines, what):
        deadline = time.monotonic() + 15
        while missing := lines - set(page(fleet.server, "metrics").splitlines()):
            check(time.monotonic() < deadline, f"{what}: {sorted(missing)} not on the page")
            time.sleep(0.2)

    wait_for({'rips_robot_level{level="DEFAULT",robot="r1"} 1',
              'rips_robot_level_index{robot="r1"} 0',
              'rips_robot_effective_level_index{robot="r1"} 0',
              'rips_robot_stage{robot="r1",stage="verified"} 1',
              f'rips_robot_bundle_info{{bundle="{fleet.level()["bundle"]}",robot="r1"}} 1',
              'rips_robot_judged{robot="r1"} 1',
              'rips_robot_agents_connected{agent="sensor",robot="r1"} 1',
              'rips_robot_agents_connected{agent="actuator",robot="r1"} 1',
              'rips_streams_open{agent="sensor"} 1', 'rips_streams_open{agent="actuator"} 1',
              'rips_store_healthy 1'}, "an armed robot")
    text = page(fleet.server, "metrics")
    for name in ("rips_robot_certificate_expiry_seconds", "rips_store_commit_seconds_bucket",
                 "rips_store_bytes", "rips_robot_tasks_waiting", "rips_robot_status_age_seconds"):
        check(f"\n{name}{{" in text, f"{name} is not on the page")
    compromise(fleet)
    wait_for({'rips_robot_level{level="COMPROMISED",robot="r1"} 1'}, "a raise")
    check('level="DEFAULT"' not in page(fleet.server, "metrics"), "two levels are shown")

    inventory = (fleet.dir / "robots.yaml").read_text()
    fleet.write("robots.yaml", inventory.replace("id: r1", "id: r9"))
    fleet.server.child.send_signal(signal.SIGHUP)
    wait_for({'rips_robot_level{level="DEFAULT",robot="r9"} 1'}, "another inventory")
    # The agents of the robot that has left go on trying.
    for _ in range(10):
        text = page(fleet.server, "metrics")
        check('"r1"' not in text and '"r1/' not in text, f"of a robot that has left: {text}")
        time.sleep(0.2)
    fleet.write("robots.yaml", inventory)
    fleet.server.child.send_signal(signal.SIGHUP)
    wait_for({'rips_robot_level{level="COMPROMISED",robot="r1"} 1',
              'rips_robot_agents_connected{agent="sensor",robot="r1"} 1'}, "the robot is back")


INSPECTING = """
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
vars: seen bool = false;
rules Msg:
  spin:
    topicin("/cmd_vel") && payload("yara/spin.yar") && !seen ?
      set(seen, true) => alert(Sender + " makes it spin", "critical") => trigger(COMPROMISED);
rules Graph:
  unused: false ? trigger(ALERT), trigger(HALT);
"""
# A Twist is a CDR header of 4 bytes and six doubles; the last is the turn about z. 1.5 rad/s:
SPIN = "rule spin { strings: $turn = { 00 00 00 00 00 00 F8 3F } condition: $turn at 44 }\n"


def payloads_are_inspected_and_recorded(fleet):
    """From the bytes of a DDS sample to a level: sensor, YARA, rule, actuator. What was recorded
    meanwhile replays to the same end."""
    fleet.bundle = "inspecting"
    fleet.write("bundles/inspecting/manifest.yaml",
                "name: inspecting\nrules: [spin.rul]\nyara: [yara/spin.yar]\n"
                "levels: [DEFAULT, ALERT, COMPROMISED, HALT]\non_inspection_error: ignore\n")
    fleet.write("bundles/inspecting/spin.rul", INSPECTING)
    fleet.write("bundles/inspecting/yara/spin.yar", SPIN)
    fleet.arm()
    recording = fleet.dir / "r1.rips"
    recorder = fleet.start("record", *fleet.ripsctl_args("record", "r1", "--out", str(recording)))
    time.sleep(2)  # the navigator drives, its commands are inspected
    check(fleet.level()["decided_level"] == "DEFAULT", "a good command was taken for a bad one")
    check(recorder.running, "the recording has ended")

    fleet.start_intruder("rogue-cmd-vel", "--node", "/rogue_driver")

    fleet.wait_level("COMPROMISED", 20)
    alerts = [a["text"] for a in fleet.alerts() if a["rule"] == "spin"]
    check(len(alerts) == 1 and alerts[0].endswith(" makes it spin"), f"alerts are {alerts}")
    recorder.kill()
    rules = fleet.dir / "bundles/inspecting/spin.rul"
    replayed = fleet.query("rules", "replay", "--rules", str(rules), "--events", str(recording))
    check(replayed["level"] == "COMPROMISED", f"replayed to {replayed['level']}")
    check([a["text"] for a in replayed["alerts"]] == alerts, f"replayed {replayed['alerts']}")
    check(replayed["events"]["message"] > 10, f"recorded only {replayed['events']}")


FINDING = """
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
rules External:
  R: finding("impostor") && CurrLevel < ALERT ? alert("somebody plays RIPS") => trigger(ALERT);
  unused: false ? trigger(COMPROMISED), trigger(HALT);
"""


def findings_are_told(fleet):
    """What is wrong on the bus whatever the rules say: alerts of their own and events for rules; and
    RIPS's own processes are none of it, whoever is started again."""
    fleet.bundle = "finding"
    fleet.write("bundles/finding/manifest.yaml",
                "name: finding\nrules: [r.rul]\nlevels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
    fleet.write("bundles/finding/r.rul", FINDING)
    fleet.arm()

    def told(kind=""):
        return [a["text"] for a in fleet.alerts()
                if f"finding {kind}" in a["text"] and a["severity"] == "high"]

    def explained(alert):
        return json.loads(fleet.ripsctl("--output", "json", "explain", alert["id"])[1])

    def wait_told(kind, count=1):
        deadline = time.monotonic() + 25
        while len(told(kind)) < count:
            check(time.monotonic() < deadline, f"{kind} is not told: {told()}")
            time.sleep(0.2)
        return told(kind)[-1]

    fleet.actuator.kill(signal.SIGKILL)
    fleet.actuator = fleet.start_agent("actuator")
    fleet.wait_level("DEFAULT", 30)
    time.sleep(7)  # longer than the grace for those whom the server does not name
    check(not told(), f"told without a reason: {told()}")

    impostor = fleet.start_intruder("unknown-node", "--node", "/rips")

    text = wait_told("impostor")
    check("sensor base: " in text and "node /rips" in text and "GUID " in text, text)
    fleet.wait_level("ALERT", 20)
    alert = [a for a in fleet.alerts() if "finding impostor" in a["text"]][0]
    check((alert["rule"], alert["severity"]) == ("(rips)", "high"), f"{alert}")
    check(len([a for a in fleet.alerts() if a["text"] == "somebody plays RIPS"]) == 1,
          "the rule did not see it once")
    who = explained(alert)
    check(who["finding"]["state"] == "stands", f"{who['finding']}")
    check(who["alert"]["subjects"][0]["pid"] and who["alert"]["subjects"][0]["host"],
          f"the process is not named: {who['alert']}")
    check(who["findings"]["total"] == 1 and who["findings"]["newest"][0]["kind"] == "impostor",
          f"{who['findings']}")
    # Somebody steers the robot, and is gone before anybody asks who it was.
    done = subprocess.run([fleet.bin / "robot_sim", "set-mode", "--domain", str(fleet.domain),
                           "--part", "/safety", "--mode", "ALERT"], env=fleet.env,
                          capture_output=True, timeout=30, check=False)
    check(done.returncode == 0, f"the mode could not be set: {done.stderr}")
    text = wait_told("foreign_mode_writer")
    check("topic /safety/change_mode" in text and "it has left: " in text, text)
    impostor.kill()
    fleet.server.wait_for(lambda line: "no longer: finding impostor" in line, 20,
                          "the end of the finding is on record")
    who = explained(alert)["finding"]
    check(who["state"] == "ended" and who["ended"] is not None, f"{who}")
    second = fleet.start_publisher("--node", "/camera")
    check("node /camera" in wait_told("duplicate_node"), "the node is not named")
    second.kill()
    fleet.start_intruder("rogue-cmd-vel", "--anonymous")
    check("topic /cmd_vel" in wait_told("non_ros_writer"), "the topic is not named")
    raw = fleet.start("raw", *fleet.robot_sim("probe"), "--topic", "/cmd_vel")
    text = wait_told("non_ros_reader")
    check("topic /cmd_vel" in text and "reads without a node" in text, text)
    raw.kill()
    fleet.server.wait_for(lambda line: "no longer: finding non_ros_reader" in line, 20,
                          "the reader has gone")
    before = len(told())
    code, text, _ = fleet.ripsctl("robot", "coverage", "r1", check=False)
    check(code == 1 and "non_ros_writer" in text and "impostor" not in text, f"{code}: {text}")

    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()

    fleet.wait_level("ALERT", 40)
    wait_told("non_ros_writer", 2)  # it stands, and the server has forgotten
    time.sleep(7)
    check(len(told()) == before + 1, f"more is told than stands: {told()}")


LOAD_RULES = """
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
vars:
  came bool = false;
  passed bool = false;
rules Msg:
  flood: topicmatches("^/load") && msgcount(1000, 1000000, 2000000) ? alert("a flood");
rules Graph:
  stays: hasnodes("/stays") && !came ? set(came, true) => alert("one came that stays");
  passes: hasnodes("/passes") && !passed ? set(passed, true) => alert("one came that left again");
rules External:
  told: signal("SIGUSR1") ? alert("told by a signal") => trigger(ALERT);
  unused: false ? trigger(COMPROMISED), trigger(HALT);
"""
# Sanitizers take most of what the machine has.
LOAD_RATE = 500 if os.environ.get("RIPS_SANITIZE") else 2_000


def arm_under_load(fleet):
    """A server and a sensor with little memory; no robot, so that all messages are counted."""
    fleet.bundle = "load"
    fleet.write("bundles/load/manifest.yaml",
                "name: load\nrules: [load.rul]\nlevels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
    fleet.write("bundles/load/load.rul", getattr(fleet, "load_rules", LOAD_RULES))
    fleet.sensor_options = "outbox: {memory: 1MiB, disk: 64MiB}\n"
    fleet.prepare()
    fleet.server = fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")
    fleet.sensor.wait_for(lambda line: " streaming " in line, 20, "the sensor streams")


def published(load):
    """Ends a publisher; how many messages it sent."""
    load.child.send_signal(signal.SIGTERM)
    _, line = load.wait_for(lambda text: '"published"' in text and text, 20, "the count is told")
    load.kill()
    return json.loads(line)["sent"]


def wait_all_is_judged(fleet, seconds):
    """Until the sensor holds nothing that is not acknowledged, for three looks in a row."""
    deadline = time.monotonic() + seconds
    quiet = 0
    while quiet < 3:
        time.sleep(0.7)
        held = metrics(fleet.sensor)
        left = {name: value for name, value in held.items() if value > 0 and name in (
            "rips_sensor_outbox_bytes", "rips_sensor_backlog_bytes", "rips_sensor_spool_bytes")}
        quiet = 0 if left else quiet + 1
        check(time.monotonic() < deadline, f"not acknowledged after {seconds} s: {left}")


def backlogged(fleet):
    held = metrics(fleet.sensor)
    return held["rips_sensor_backlog_bytes"] + held["rips_sensor_spool_bytes"] > 0


def judged_messages(fleet):
    """Messages judged, each once, whatever died in between: the highest sequence of each message
    lane, as the server's store has it. Sequences begin at 1 and have no gaps, or those are counted
    as lost."""
    with sqlite3.connect(f"file:{fleet.dir}/server/state.db?mode=ro", uri=True) as store:
        return dict(store.execute("SELECT incarnation, sequence FROM high_water WHERE lane = 2"))


def server_killed_under_load(fleet):
    """Everything seen in a minute without server is judged afterwards, or counted as lost; and the
    server that comes back is not flooded."""
    arm_under_load(fleet)
    load = fleet.start_publisher("--rate", LOAD_RATE)
    load.wait_for(lambda line: '"publishing"' in line, 20, "the publisher is read")
    time.sleep(5)
    before = cpu_seconds(fleet.server)
    time.sleep(10)
    steady = (cpu_seconds(fleet.server) - before) / 10
    lost = metrics(fleet.server)["rips_observations_lost_total"]

    fleet.server.kill(signal.SIGKILL)
    spooled = 0
    for second in range(60):
        time.sleep(1)
        if second == 20:
            fleet.sensor.child.send_signal(signal.SIGUSR1)
        if second == 25:
            passing = fleet.start_intruder("unknown-node", "--node", "/passes")
        if second == 35:
            passing.kill()
            fleet.start_intruder("unknown-node", "--node", "/stays")
        spooled = max(spooled, metrics(fleet.sensor)["rips_sensor_spool_bytes"])
    check(spooled > 0, "nothing went to disk")
    so_far = len(fleet.sensor.lines)
    fleet.server = fleet.start_server()
    fleet.sensor.wait_for(lambda line: " streaming " in line, 30, "the sensor streams again",
                          start=so_far)
    before, at = cpu_seconds(fleet.server), time.monotonic()
    busiest = 0.0
    deadline = at + 60
    while backlogged(fleet):
        time.sleep(1)
        now, now_at = cpu_seconds(fleet.server), time.monotonic()
        busiest = max(busiest, (now - before) / (now_at - at))
        before, at = now, now_at
        check(now_at < deadline, "the backlog does not become less")
    sent = published(load)
    wait_all_is_judged(fleet, 30)

    judged = judged_messages(fleet)
    lost += metrics(fleet.server)["rips_observations_lost_total"]
    check(len(judged) == 2, f"one lane for what is live and one for the backlog: {judged}")
    check(sum(judged.values()) + lost == sent, f"sent {sent}, judged {judged}, lost {lost:g}")
    check(sent > 70 * LOAD_RATE * 0.9, f"only {sent} messages were sent")
    texts = [alert["text"] for alert in fleet.alerts()]
    for text in ("told by a signal", "one came that stays", "one came that left again"):
        check(texts.count(text) == 1, f"`{text}` is told {texts.count(text)} times: {texts}")
    check(fleet.level()["decided_level"] == "ALERT", "the signal was not judged")
    print(f"server: {steady:.3f} processors in steady state, at most {busiest:.3f} catching up")
    check(busiest < 15 * max(steady, 0.02), f"catching up took {busiest:.3f} processors, steady "
          f"state {steady:.3f}")


def sensor_restarted_while_the_server_is_away(fleet):
    """What a sensor holds when it ends in order is sent by the next one."""
    arm_under_load(fleet)
    # It stays when it has sent all: a graph that changes while nobody can be told is a loss.
    first = fleet.start_publisher("--rate", LOAD_RATE, "--count", 16_000)
    first.wait_for(lambda line: '"publishing"' in line, 20, "the publisher is read")
    time.sleep(3)
    lost = metrics(fleet.server)["rips_observations_lost_total"]
    fleet.server.kill(signal.SIGKILL)
    fleet.sensor.child.send_signal(signal.SIGUSR1)
    _, line = first.wait_for(lambda text: '"published"' in text and text, 30, "all is sent")
    sent = json.loads(line)["sent"]
    time.sleep(1)

    check(fleet.sensor.kill() == 0, "the sensor did not end in order")

    segments = list((fleet.dir / "sensor/spool").glob("*.seg"))
    check(segments, "nothing is spooled")
    check(not (fleet.dir / "sensor/spool/running").exists(), "it did not end in order")
    fleet.sensor = fleet.start_agent("sensor")
    # On a topic of its own: on one that is read already, a publisher may be heard by the reader's
    # process before that knows it, and its first messages are nobody's.
    second = fleet.start_publisher("--rate", LOAD_RATE, "--count", 4_000, "--node", "/load_2",
                                   "--topic", "/load_2")
    _, line = second.wait_for(lambda text: '"published"' in text and text, 30, "more is sent")
    sent += json.loads(line)["sent"]
    fleet.server = fleet.start_server()
    fleet.sensor.wait_for(lambda line: " streaming " in line, 30, "the sensor streams")
    wait_all_is_judged(fleet, 60)

    judged = judged_messages(fleet)
    lost += metrics(fleet.server)["rips_observations_lost_total"]
    check(sum(judged.values()) + lost == sent, f"sent {sent}, judged {judged}, lost {lost:g}")
    texts = [alert["text"] for alert in fleet.alerts()]
    check(texts.count("told by a signal") == 1, f"the signal is told in {texts}")
    check(not list((fleet.dir / "sensor/spool").glob("*.seg")), "segments stay behind")


DRIVER_RULES = """
levels:
  DEFAULT;
  ALERT;
  COMPROMISED;
  HALT;
rules Msg:
  rogue: topicmatches("^/load") && !publishers("/load") ? alert("a rogue") => trigger(COMPROMISED);
rules External:
  unused: false ? trigger(ALERT), trigger(HALT);
"""


def nodes_that_ended_while_the_server_was_away(fleet):
    """What a node sent is judged by the nodes of that time: it may have ended, and the sensor, too,
    when the server is back. One that was a rogue then is accused."""
    fleet.load_rules = DRIVER_RULES
    arm_under_load(fleet)

    def runs_while_the_server_is_away(*options, site=False):
        fleet.server.kill(signal.SIGKILL)
        load = fleet.start_publisher("--rate", 100, *options)
        load.wait_for(lambda line: '"publishing"' in line, 20, "the publisher is read")
        deadline = time.monotonic() + 20
        while not backlogged(fleet):  # not live any more
            check(time.monotonic() < deadline, "nothing is set aside")
            time.sleep(0.2)
        published(load)
        if site:  # its last messages are live when the sensor stops
            check(fleet.sensor.kill() == 0, "the sensor did not end in order")
            fleet.sensor = fleet.start_agent("sensor")
        time.sleep(1)
        before = len(fleet.sensor.lines)
        fleet.server = fleet.start_server()
        fleet.sensor.wait_for(lambda line: " streaming " in line, 30, "the sensor streams",
                              start=0 if site else before)
        wait_all_is_judged(fleet, 60)
        return [alert["event"] for alert in fleet.alerts() if alert["text"] == "a rogue"]

    for site in (False, True):
        accused = runs_while_the_server_is_away(site=site)
        check(not accused, f"a node that ended is accused (all restarted: {site}): {accused[:1]}")
    check(fleet.level()["decided_level"] == "DEFAULT", "the level was raised")
    accused = runs_while_the_server_is_away("--node", "/rogue", site=True)
    check(accused and "/rogue" in accused[0], f"the rogue is not accused: {accused[:1]}")
    check(fleet.level()["decided_level"] == "COMPROMISED", "the level was not raised")


def drivers_while_the_server_is_away(fleet):
    """Who drives beside the allowed node while the server is away, however it went, and has ended
    when it is back, is accused; each time, and also if the sensor was stopped meanwhile."""
    fleet.load_rules = DRIVER_RULES
    arm_under_load(fleet)
    allowed = fleet.start_publisher("--rate", 5)  # of a rule at most 100 alerts a second
    allowed.wait_for(lambda line: '"publishing"' in line, 20, "the allowed node is read")
    time.sleep(3)
    for name, how in (("/a", signal.SIGTERM), ("/b", signal.SIGTERM), ("/c", signal.SIGKILL),
                      ("/d", signal.SIGTERM)):
        fleet.server.kill(how)
        time.sleep(3)  # the allowed node's messages are set aside by now
        rogue = fleet.start_publisher("--rate", 5, "--node", name)
        rogue.wait_for(lambda line: '"publishing"' in line, 20, "the rogue is read")
        time.sleep(4)
        published(rogue)
        if name == "/d":
            check(fleet.sensor.kill() == 0, "the sensor did not end in order")
            fleet.sensor = fleet.start_agent("sensor")
        time.sleep(3)
        before = 0 if name == "/d" else len(fleet.sensor.lines)
        fleet.server = fleet.start_server()
        fleet.sensor.wait_for(lambda line: " streaming " in line, 30, "the sensor streams",
                              start=before)
        deadline = time.monotonic() + 60
        while backlogged(fleet):  # what is live goes on
            check(time.monotonic() < deadline, "what was set aside is not judged")
            time.sleep(0.2)
        accused = [alert["event"] for alert in fleet.alerts()
                   if alert["text"] == "a rogue" and f"from {name}" in alert["event"]]
        check(accused, f"{name} is not accused after {how.name}")
        lost = [alert["text"] for alert in fleet.alerts() if "and did not come" in alert["text"]]
        check(not lost, f"an alert reports a loss that did not happen: {lost}")
    check(fleet.level()["decided_level"] == "COMPROMISED", "the level was not raised")
    published(allowed)


UNKNOWN_NODE_RULES = """
levels:
  DEFAULT;
  ALERT;
  COMPROMISED;
  HALT;
vars:
  unknown bool = false;
rules Graph:
  came: !nodesinclude("/load", "/rips") && !unknown ?
    set(unknown, true) => alert("an unknown node") => trigger(ALERT);
  left: nodesinclude("/load", "/rips") && unknown ? set(unknown, false) => alert("all known", "info");
rules Msg:
  none: topicmatches("^/load") && topicmatches("^/none") ? alert("none");
rules External:
  unused: false ? trigger(COMPROMISED), trigger(HALT);
"""


def unknown_nodes_while_the_server_is_away(fleet):
    """A node that joins and leaves while the server is away raises an alert, also if the sensor stops
    before the server is back; an allowed node raises none, and no observation is lost."""
    fleet.load_rules = UNKNOWN_NODE_RULES
    arm_under_load(fleet)

    def comes_and_goes(*options):
        node = fleet.start_publisher("--rate", 5, *options)
        node.wait_for(lambda line: '"publishing"' in line, 20, "the node is read")
        time.sleep(2)
        published(node)
        time.sleep(2)  # the sensor has seen it go

    for name, alerts in (("/load", 0), ("/unknown", 1)):
        fleet.server.kill(signal.SIGTERM)
        time.sleep(2)
        comes_and_goes("--node", name)
        check(fleet.sensor.kill() == 0, "the sensor did not end in order")
        fleet.sensor = fleet.start_agent("sensor")
        fleet.server = fleet.start_server()
        fleet.sensor.wait_for(lambda line: " streaming " in line, 30, "the sensor streams")
        comes_and_goes()  # it is seen that the sensor has gone on
        deadline = time.monotonic() + 60
        while backlogged(fleet):
            check(time.monotonic() < deadline, "what was left is not judged")
            time.sleep(0.2)
        texts = [alert["text"] for alert in fleet.alerts()]
        check(texts.count("an unknown node") == alerts, f"{name}: {texts}")
        check(texts.count("all known") == alerts, f"{name} has gone: {texts}")
        check(not [text for text in texts if "were lost" in text], f"an alert reports a loss: {texts}")
    late = [alert["event"] for alert in fleet.alerts() if alert["text"] == "an unknown node"]
    check("it came late" in late[0], late[0])
    check(fleet.level()["decided_level"] == "ALERT", "the level was not raised")


RESTORED_RULES = """
levels:
  DEFAULT;
  ALERT;
  COMPROMISED;
  HALT;
rules Msg:
  flood: topicmatches("^/load") && msgcount(2000, 1500, 1000000) ? alert("a flood") => trigger(HALT);
rules External:
  lost: lostevents(1) ? alert("a loss") => trigger(ALERT);
  unused: false ? trigger(COMPROMISED);
"""


def store_restored_from_a_backup(fleet):
    """A backup of the store is restored, and the sensor was started again since: that is told once,
    and what was judged after the backup is neither a loss nor a flood."""
    fleet.load_rules = RESTORED_RULES
    arm_under_load(fleet)
    # Less than a flood.
    load = fleet.start_publisher("--rate", 200)
    load.wait_for(lambda line: '"publishing"' in line, 20, "the publisher is read")
    time.sleep(3)
    state = fleet.dir / "server/state.db"
    with sqlite3.connect(state) as live, sqlite3.connect(fleet.dir / "backup.db") as backup:
        live.backup(backup)
    at_backup = sum(judged_messages(fleet).values())
    deadline = time.monotonic() + 60
    while sum(judged_messages(fleet).values()) < at_backup + 3_000:
        check(time.monotonic() < deadline, "messages are not judged")
        time.sleep(0.5)
    fleet.server.kill(signal.SIGKILL)
    time.sleep(1)
    check(fleet.sensor.kill() == 0, "the sensor did not end in order")
    check(list((fleet.dir / "sensor/spool").glob("*.seg")), "nothing is spooled")

    for name in ("state.db-wal", "state.db-shm"):
        (fleet.dir / "server" / name).unlink(missing_ok=True)
    shutil.copy(fleet.dir / "backup.db", state)
    fleet.server = fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")
    fleet.sensor.wait_for(lambda line: " streaming " in line, 30, "the sensor streams")
    published(load)
    wait_all_is_judged(fleet, 60)

    texts = [alert["text"] for alert in fleet.alerts()]
    check(sum("a backup was restored" in text for text in texts) == 1, f"not told once: {texts}")
    check(not any("a flood" in text or "a loss" in text or "have a number and did not come" in text
                  for text in texts), f"what the backup lacks is told as lost: {texts}")
    check(fleet.level()["decided_level"] == "DEFAULT", "the level was raised")
    fleet.server.kill()
    fleet.server = fleet.start_server()
    fleet.sensor.wait_for(lambda line: " streaming " in line, 30, "the sensor streams again",
                          start=len(fleet.sensor.lines))
    wait_all_is_judged(fleet, 60)
    texts = [alert["text"] for alert in fleet.alerts()]
    check(sum("a backup was restored" in text for text in texts) == 1, f"told again: {texts}")


def starts_and_stops(fleet):
    """A robot that boots or stops under its sensor, whole or node by node, is no attack: neither
    live nor when what was recorded is replayed."""
    if os.environ.get("RIPS_SANITIZE"):
        raise Skipped("a node that has gone before the sensor heard its claim is accused, and must be")
    fleet.prepare()
    fleet.server = fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")
    fleet.actuator = fleet.start_agent("actuator")
    recording = fleet.dir / "starts.rips"
    recorder = fleet.start("record", *fleet.ripsctl_args("record", "r1", "--out", str(recording)))
    rounds = 50
    # Claims reach the sensor within a heartbeat of the writer, 100 ms; one that leaves before that
    # is accused, and must be.
    def live():
        time.sleep(random.uniform(0.15, 0.4))

    for i in range(rounds):
        robot = fleet.start_robot()
        live()
        robot.kill(signal.SIGKILL if i % 10 == 9 else signal.SIGTERM)
        fleet.processes.remove(robot)
    drivers = ["/camera,/lidar", "/navigator", "/base"]
    for alone in drivers:
        robot = fleet.start_robot("--only", ",".join(each for each in drivers if each != alone))
        for i in range(rounds):
            part = fleet.start_robot("--only", alone, "--manager", "absent")
            live()
            part.kill()
            fleet.processes.remove(part)
        robot.kill()
    time.sleep(3)
    check(recorder.running, "the recording has ended")
    recorder.kill()

    raised = [a for a in fleet.alerts() if a["rule"] != "(rips)"]
    check(not raised, f"rules alerted: {raised}")
    check(len(decided(fleet)) == 1, f"the level changed: {decided(fleet)}")
    rules = SOURCE / "rules/warehouse/warehouse.rul"
    replayed = fleet.query("rules", "replay", "--rules", str(rules), "--events", str(recording))
    check(replayed["events"]["message"] > 5 * rounds, f"recorded only {replayed['events']}")
    check(replayed["events"]["graph"] > rounds // 2, f"recorded only {replayed['events']}")
    check(not replayed["alerts"], f"the replay alerted: {replayed['alerts']}")
    check(not replayed["transitions"], f"the replay changed levels: {replayed['transitions']}")


def camera_guard_watches_a_real_camera(fleet):
    """The shipped policy on the pictures of a real camera: 640x480 rgb8 at 30 Hz, 0.9 MB each, through
    DDS, sensor, wire and plugin. Good pictures raise nothing, a covered lens raises ALERT."""
    if os.environ.get("RIPS_SANITIZE"):
        raise Skipped("a plugin's budget of real time is too short for a sanitizer")
    closed = [each for each in fleet.dir.parents if not each.stat().st_mode & 0o001]
    if closed and os.geteuid() == 0:
        raise Skipped(f"plugins run as `nobody`, who may not enter {closed[-1]}")
    fleet.bundle = "camera-guard"
    fleet.levels = ["DEFAULT", "ALERT", "COMPROMISED"]
    shutil.copytree(fleet.bin.parent / "bundles/camera-guard", fleet.dir / "bundles/camera-guard")
    fleet.smh = fleet.write("smh.yaml", fleet.smh.read_text().replace("frame_rate: 15.0",
                                                                     "frame_rate: 30.0"))
    fleet.prepare()
    fleet.server = fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")  # first, so that it knows what the rules need
    pipe = fleet.dir / "robot.orders"
    fleet.robot = fleet.start_robot("--image-width", 640, "--image-height", 480, "--control", pipe)
    fleet.actuator = fleet.start_agent("actuator")
    fleet.wait_level("DEFAULT", 40)
    before = metrics(fleet.sensor)["rips_sensor_payload_bytes_total"]
    began = time.monotonic()
    time.sleep(20)

    rules = [f"{a['rule']}: {a['text']}" for a in fleet.alerts() if a["rule"] != "(rips)"]
    check(not rules, f"good pictures raised alerts: {rules}")
    check(fleet.level()["decided_level"] == "DEFAULT", "good pictures raised the level")
    seen = metrics(fleet.sensor)
    rate = (seen["rips_sensor_payload_bytes_total"] - before) / (time.monotonic() - began)
    check(rate > 5 * 921_600, f"only {rate:.0f} bytes of pictures a second")
    code, out, _ = fleet.ripsctl("--output", "json", "robot", "coverage", "r1", check=False)
    check(json.loads(out)["cut_payloads"] == [], f"payloads were cut: {code} {out}")

    pipe.write_text("lens cover\n")

    fleet.wait_level("ALERT", 15)
    texts = [a["text"] for a in fleet.alerts() if a["rule"] != "(rips)"]
    check(texts == ["the camera is dazzled or covered"], f"alerts are {texts}")
    print(f"{rate / 1e6:.1f} MB/s of pictures")


def write_actuator_term(fleet, term):
    """As a damaged state file would have it: whole, with another highest term."""
    path = fleet.dir / "actuator/state"
    body = re.sub(r"highest_term \d+", f"highest_term {term}", path.read_text())
    body = body[:body.index("crc ")]
    path.write_text(body + f"crc {zlib.crc32(body.encode()):08x}\n")


def alerted(fleet, *texts):
    return any(all(text in a["text"] for text in texts) for a in fleet.alerts())


def actuator_whose_term_is_far_ahead(fleet):
    """An administrator brings an actuator and its server together again, once, and lowers nothing;
    what no term can exceed ends with the removal of the state file."""
    fleet.arm()
    driver = compromise(fleet)
    driver.kill()
    fleet.mint("operator", "admin", "root")
    reset = ["agent", "reset-term", "r1", "base", "--reason", "the disk was replaced"]
    code, _, error = fleet.ripsctl(*reset, check=False)
    check(code == 1 and "needs the role `admin`" in error, f"an operator may: {code} {error}")
    code, _, error = ripsctl_as_admin(fleet, *reset)
    check(code == 1 and "nothing to reset" in error, f"it was not needed: {code} {error}")

    fleet.actuator.kill()
    write_actuator_term(fleet, 5_000_000)
    fleet.actuator = fleet.start_agent("actuator", wait=False)
    until(fleet, 15, "the server does not say what to do",
          lambda: alerted(fleet, "far beyond ours", "ripsctl agent reset-term r1 base"))
    code, out, error = ripsctl_as_admin(fleet, *reset)
    check(code == 0 and "stays at COMPROMISED by decision 5000001." in out, f"{code} {out} {error}")
    fleet.actuator.kill()  # it would try again within a minute
    fleet.actuator = fleet.start_agent("actuator")
    fleet.wait_level("COMPROMISED", 20)
    records = [d for d in decided(fleet) if "reset-term base: the disk" in d["reason"]]
    check(len(records) == 1 and "operator root" in records[0]["cause"], f"records: {records}")
    check(alerted(fleet, "operator root", "go above term 5000000"), "no alert tells of the reset")

    fleet.actuator.kill()
    write_actuator_term(fleet, 2**64 - 1)
    fleet.actuator = fleet.start_agent("actuator", wait=False)
    until(fleet, 15, "the server does not say what to do",
          lambda: alerted(fleet, "no term can be above that", "remove its state file"))
    code, _, error = ripsctl_as_admin(fleet, *reset)
    check(code == 1 and "remove its state file" in error, f"{code} {error}")
    fleet.actuator.kill()
    (fleet.dir / "actuator/state").unlink()
    fleet.actuator = fleet.start_agent("actuator")
    fleet.wait_level("COMPROMISED", 30)


def ripsctl_as_admin(fleet, *args):
    return ripsctl_as(fleet, "admin", "root", *args)


def ripsctl_as(fleet, role, name, *args):
    """As Fleet.ripsctl, which asks as operator alice, and never fails."""
    pki = fleet.dir / "pki/operator" / role / name
    done = subprocess.run(
        [fleet.bin / "ripsctl", "--server", f"127.0.0.1:{fleet.port}", "--ca", pki / "ca.pem",
         "--cert", pki / "cert.pem", "--key", pki / "key.pem", *args],
        capture_output=True, text=True, timeout=60, env=fleet.env)
    return done.returncode, done.stdout, done.stderr


def until(fleet, seconds, what, found):
    deadline = time.monotonic() + seconds
    while not found():
        check(time.monotonic() < deadline, f"{what}: {[a['text'] for a in fleet.alerts()][-5:]}")
        time.sleep(0.2)


SCENARIOS = [kill_server_while_compromised, explained_when_the_driver_has_gone,
             alerts_replay_to_the_same_verdict, two_persons_release_a_robot, audit_log_outlives_a_kill,
             audit_log_put_back_is_contradicted_by_the_robot,
             kill_server_at_the_moment_of_a_raise,
             kill_sensor_in_the_story, sensor_on_a_wrong_domain, kill_actuator_while_compromised,
             server_absent_at_agent_start, lost_lease_raises_the_floor, manager_that_lies,
             bad_discovery_messages, programs_that_misbehave, drill, reload_of_a_broken_bundle,
             metrics_follow_the_level_and_the_inventory,
             payloads_are_inspected_and_recorded, camera_guard_watches_a_real_camera,
             findings_are_told, server_killed_under_load,
             sensor_restarted_while_the_server_is_away,
             nodes_that_ended_while_the_server_was_away, drivers_while_the_server_is_away,
             unknown_nodes_while_the_server_is_away, store_restored_from_a_backup,
             starts_and_stops, actuator_whose_term_is_far_ahead]


def main(kind_of=lambda scenario: Fleet):
    """Runs the scenario that the command line names with the kind of fleet it needs, or prints the
    names of all. Returns the exit code."""
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    scenario = next(each for each in SCENARIOS if each.__name__ == sys.argv[2])
    parent = pathlib.Path(sys.argv[1]).resolve().parent / "scenarios"
    parent.mkdir(exist_ok=True)
    directory = pathlib.Path(tempfile.mkdtemp(prefix=scenario.__name__ + ".", dir=parent))
    directory.chmod(0o755)  # plugins run as another user
    fleet = kind_of(scenario)(sys.argv[1], directory, floor_hold="1s")
    fleet.leftovers = [directory]  # removed unless it fails
    def play(fleet):
        scenario(fleet)
        never_lower(fleet, getattr(scenario, "lowers", ()))
    code = perform(scenario.__name__, play, fleet)
    if code != 1:
        for leftover in fleet.leftovers:
            shutil.rmtree(leftover)
    return code


if __name__ == "__main__":
    sys.exit(main())
