"""Two builds of RIPS at one robot, in the order in which RUNBOOK.md upgrades them, and back.

    skew_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names

BINARIES is the newer build. The previous one is in the directory RIPS_PREVIOUS_BIN, which
`tests/previous` builds. Policies, configuration, robot_sim and the tests are of this tree.
"""

import filecmp
import functools
import json
import os
import pathlib
import shutil
import signal
import sqlite3
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import fleet_test  # noqa: E402
from enrolment_test import EnrolledFleet  # noqa: E402
from fleet import Failed, Fleet, Skipped, check, eventually, metrics  # noqa: E402
from fleet_test import (  # noqa: E402
    applied, arm_under_load, audited, compromise, decided, judged_messages, kept_audit_head,
    may_lower, wait_all_is_judged)

SERVER, SENSOR, ACTUATOR = "rips-policy-server", "rips-sensor", "rips-actuator"
PROGRAMS = [SERVER, SENSOR, ACTUATOR, "ripsctl"]
LOAD_RATE = 2000  # messages a second


class TwoBuilds:
    """A part of a fleet: which of its programs are of which build. At first all are new."""

    @functools.cached_property
    def previous(self):
        """The directory with the programs of the previous build."""
        named = os.environ.get("RIPS_PREVIOUS_BIN")
        if not named:
            raise Skipped("RIPS_PREVIOUS_BIN is not set; `tests/previous` builds an earlier commit "
                          "and prints it")
        directory = pathlib.Path(named).resolve()
        for name in PROGRAMS:
            check((directory / name).exists(), f"RIPS_PREVIOUS_BIN: there is no {directory / name}")
        check(not all(filecmp.cmp(self.bin / name, directory / name, shallow=False)
                      for name in PROGRAMS),
              f"RIPS_PREVIOUS_BIN: the programs in {directory} are those under test")
        return directory

    def prepare(self):
        self.back()  # whether there is a previous build, before anything starts
        super().prepare()

    def back(self, *names):
        """From the next start of these programs on, they are of the previous build."""
        self.bin_of.update(dict.fromkeys(names, self.previous))

    def forward(self, *names):
        for name in names:
            self.bin_of.pop(name, None)


class Skewed(TwoBuilds, Fleet):
    pass


class SkewedEnrolled(TwoBuilds, EnrolledFleet):
    pass


def with_each_ripsctl(fleet, ask):
    """What ask() gives with ripsctl of the new build and of the previous one."""
    answers = []
    for move in (fleet.forward, fleet.back):
        move("ripsctl")
        time.sleep(0.3)  # some questions count for five of the 20 a second that the server allows
        answers.append(ask())
    fleet.forward("ripsctl")
    return answers


def wait_graph(fleet, node, there):
    """Until the node is in the graph that the server has, or is not. Each look counts for five."""
    eventually(lambda: (node in fleet.ripsctl("robot", "graph", "r1")[1]) == there, 20,
               f"{node} {'is in' if there else 'has left'} the graph", every=0.5)


def wait_mode(fleet, mode, seconds=20):
    eventually(lambda: fleet.mode()["mode"] == mode, seconds, f"the robot is in mode {mode}")


def ids(records, key):
    return [each[key] for each in records]


def texts_of_alerts(fleet):
    return [each["text"] for each in fleet.alerts()]


def check_history(fleet, history):
    now = decided(fleet)
    check(now == history, f"decisions changed from {history} to {now}")


def file_alerts(fleet):
    """The alert file of the server: the ids of its alerts, oldest first."""
    return ids([json.loads(line) for line in
                (fleet.dir / "server/alerts.jsonl").read_text().splitlines()], "id")


def state_of_actuator(fleet):
    """What the actuator keeps on its host: name to text."""
    text = (fleet.dir / "actuator/state").read_text()
    return dict(line.partition(" ")[::2] for line in text.splitlines())


def audit_head(fleet):
    return json.loads(fleet.ripsctl("audit", "verify", str(fleet.dir / "server/audit"), "--output",
                                    "json")[1])["head"]


def same_words(fleet):
    """Both builds of ripsctl show the same robot, and replay what the server recorded."""
    for words, texts in ((("robot", "list"), ["r1"]),
                         (("robot", "graph", "r1"), ["/navigator", "/cmd_vel"]),
                         (("level", "show", "r1"), ["COMPROMISED"]),
                         (("agent", "list"), ["sensor", "actuator"]),
                         (("robot", "receipts", "r1"), ["level COMPROMISED"]),
                         (("explain", "r1"), ["rule rogue_driver", "r1 is at COMPROMISED"])):
        for shown in with_each_ripsctl(fleet, lambda: fleet.ripsctl(*words)[1]):
            missing = [text for text in texts if text not in shown]
            check(not missing, f"ripsctl {' '.join(words)} shows no {missing}:\n{shown}")
    new, old = with_each_ripsctl(fleet, lambda: ids(fleet.history(), "decision_id"))
    check(new and new == old, f"histories differ: {new} {old}")
    new, old = with_each_ripsctl(fleet, lambda: ids(fleet.alerts(), "id"))
    check(new and old[:len(new)] == new, f"alerts differ: {new} {old}")
    rogue = next(each for each in fleet.alerts() if each["rule"] == "rogue_driver")
    eventually(lambda: fleet.ripsctl("alert", "recording", rogue["id"], "--out",
                                     str(fleet.dir / "first.rips"), "--force", check=False)[0] == 0,
               10, "the recording is saved")
    for result, _ in with_each_ripsctl(fleet, lambda: fleet.replay(rogue)):
        check(any(each["id"] == rogue["id"] and each["event"] is not None
                  for each in result["recorded"]), f"another verdict: {result}")


def protect(fleet):
    """An unknown node in the graph raises to ALERT, a second driver to COMPROMISED; an operator lowers
    with each build of ripsctl. Each level is verified."""
    fleet.arm()
    unknown = fleet.start_intruder("unknown-node", "--node", "/unknown")
    fleet.wait_level("ALERT", 20)
    check(fleet.mode()["mode"] == "ALERT", "the robot is not in mode ALERT")
    driver = compromise(fleet)
    check(fleet.mode()["mode"] == "COMPROMISED", "the robot is not in mode COMPROMISED")
    same_words(fleet)
    unknown.kill()
    driver.kill()
    for node in ("/unknown", "/intruder"):
        wait_graph(fleet, node, there=False)

    def order(verb, level, mode):
        fleet.ripsctl("level", verb, "r1", "--to", level, "--reason", "seen on the floor", "--wait")
        fleet.wait_level(level, 20)
        check(fleet.mode()["mode"] == mode, f"the robot is not in mode {mode}")

    fleet.back("ripsctl")
    order("lower", "DEFAULT", "__DEFAULT__")
    order("raise", "HALT", "HALT")
    fleet.forward("ripsctl")
    order("lower", "DEFAULT", "__DEFAULT__")
    order("raise", "HALT", "HALT")
    for records in with_each_ripsctl(fleet, lambda: audited(fleet)):
        ordered = [each["to"] for each in records
                   if each["kind"] == "decision" and each["actor"].startswith("operator alice")]
        check(ordered == ["DEFAULT", "HALT"] * 2, f"audited: {ordered}")


LOWERED = (("operator alice", "COMPROMISED", "DEFAULT"), ("operator alice", "HALT", "DEFAULT"))


# ------------------------------------------------------------------------------------ scenarios


@may_lower(*LOWERED)
def new_server_with_previous_agents(fleet):
    fleet.back(SENSOR, ACTUATOR)
    protect(fleet)


@may_lower(*LOWERED)
def previous_server_with_new_agents(fleet):
    """Not the order of an upgrade, but what a robot from elsewhere may meet."""
    fleet.back(SERVER)
    protect(fleet)


@may_lower(("operator alice", "COMPROMISED", "DEFAULT"))
def upgrade_at_a_raised_level(fleet):
    """The server first, on the files of the previous one, then each agent on its own: the level is
    held throughout, and nothing is forgotten."""
    fleet.back(*PROGRAMS)
    fleet.arm()
    driver = compromise(fleet)
    eventually(lambda: kept_audit_head(fleet), 20, "the actuator keeps a head of the audit log")
    history, alerts, head = decided(fleet), ids(fleet.alerts(), "id"), audit_head(fleet)
    entered = applied(fleet)

    check(fleet.server.kill() == 0, "the server did not end in order")
    told = file_alerts(fleet)
    fleet.forward(SERVER)
    fleet.server = fleet.start_server()
    fleet.wait_level("COMPROMISED", 20)
    time.sleep(8)  # longer than soft_hold
    check_history(fleet, history)
    check(applied(fleet) == entered, "a level was entered again")
    now = ids(fleet.alerts(), "id")
    check(now[:len(alerts)] == alerts, f"alerts changed from {alerts} to {now}")
    check(file_alerts(fleet)[:len(told)] == told, "the alert file does not go on")
    same_words(fleet)
    for _ in with_each_ripsctl(fleet, lambda: audited(fleet)):
        fleet.ripsctl("audit", "verify", str(fleet.dir / "server/audit"), "--head", head)

    check(fleet.sensor.kill() == 0, "the sensor did not end in order")
    fleet.forward(SENSOR)
    fleet.sensor = fleet.start_agent("sensor")
    wait_graph(fleet, "/navigator", there=True)
    fleet.wait_level("COMPROMISED", 20)

    kept, kept_head = state_of_actuator(fleet), kept_audit_head(fleet)
    check((kept["decided"], kept["effective"]) == ("COMPROMISED", "COMPROMISED"), f"{kept}")
    check(fleet.actuator.kill() == 0, "the actuator did not end in order")
    check(fleet.mode()["mode"] == "COMPROMISED", "the robot left its mode with the actuator")
    fleet.forward(ACTUATOR)
    fleet.actuator = fleet.start_agent("actuator")
    fleet.wait_level("COMPROMISED", 20)
    now = state_of_actuator(fleet)
    check(all(now[name] == kept[name] for name in ("mark", "decided", "effective"))
          and int(now["highest_term"]) >= int(kept["highest_term"]), f"from {kept} to {now}")
    check(kept_audit_head(fleet)[0] >= kept_head[0], "an older head of the audit log is kept")
    check(fleet.mode()["mode"] == "COMPROMISED", "the robot left its mode")
    check_history(fleet, history)
    told = [text for text in texts_of_alerts(fleet)
            if any(word in text for word in ("contradicted", "adopted", "have a number"))]
    check(not told, f"told: {told}")

    driver.kill()
    wait_graph(fleet, "/intruder", there=False)
    eventually(lambda: fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--reason",
                                     "all is upgraded", check=False)[0] == 0, 20, "it is lowered")
    fleet.wait_level("DEFAULT", 20)
    audited(fleet)
    fleet.ripsctl("audit", "verify", str(fleet.dir / "server/audit"), "--head", head)


def start_on_newer_store(fleet):
    """Starts the server; whether it takes the store. If not, it says why."""
    try:
        fleet.server = fleet.start_server()
    except Failed as failed:
        check("schema version" in str(failed) and "run the newer program" in str(failed),
              f"the previous server does not say why it refuses the store: {failed}")
        return False
    return True


def previous_server_on_a_newer_store(fleet):
    """It holds what was decided, or refuses the store and leaves it as it is. One version further,
    it refuses."""
    fleet.arm()
    compromise(fleet)
    history = decided(fleet)
    check(fleet.server.kill() == 0, "the server did not end in order")
    fleet.back(SERVER)
    takes_it = start_on_newer_store(fleet)
    print(f"the previous server {'takes' if takes_it else 'refuses'} the store of the new one")
    if takes_it:
        fleet.wait_level("COMPROMISED", 30)
        check_history(fleet, history)
        audited(fleet)
        check(fleet.server.kill() == 0, "the server did not end in order")
    path = fleet.dir / "server/state.db"
    with sqlite3.connect(path) as store:
        version = store.execute("PRAGMA user_version").fetchone()[0]
        store.execute(f"PRAGMA user_version = {version + 1}")
    store.close()
    before = path.read_bytes()
    check(not start_on_newer_store(fleet), "the previous server takes a store of another version")
    check(path.read_bytes() == before, "the store that it refused has changed")
    with sqlite3.connect(path) as store:
        store.execute(f"PRAGMA user_version = {version}")
    store.close()

    fleet.forward(SERVER)
    fleet.server = fleet.start_server()
    fleet.wait_level("COMPROMISED", 30)
    check(fleet.mode()["mode"] == "COMPROMISED", "the robot left its mode")
    check_history(fleet, history)


def going_back_with_the_store_of_before(fleet):
    """What the new server decided after the backup is held by the robot, and adopted from it; the
    audit log of both builds is one."""
    fleet.back(*PROGRAMS)
    fleet.arm()
    check(fleet.server.kill() == 0, "the server did not end in order")
    store = fleet.dir / "server/state.db"
    with sqlite3.connect(store) as live:
        live.execute("VACUUM INTO ?", (str(fleet.dir / "backup.db"),))
    live.close()
    fleet.forward(*PROGRAMS)
    fleet.server = fleet.start_server()
    for role in ("sensor", "actuator"):
        getattr(fleet, role).kill()
        setattr(fleet, role, fleet.start_agent(role))
    fleet.wait_level("DEFAULT", 40)
    compromise(fleet)
    audited(fleet)

    for role in ("server", "sensor", "actuator"):
        check(getattr(fleet, role).kill() == 0, f"the {role} did not end in order")
    for name in ("state.db-wal", "state.db-shm"):
        (fleet.dir / "server" / name).unlink(missing_ok=True)
    shutil.copy(fleet.dir / "backup.db", store)
    fleet.back(*PROGRAMS)
    fleet.server = fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")
    fleet.actuator = fleet.start_agent("actuator")
    fleet.wait_level("COMPROMISED", 40)
    check(fleet.mode()["mode"] == "COMPROMISED", "the robot left its mode")
    texts = texts_of_alerts(fleet)
    check(any("the more restrictive level is adopted" in text for text in texts),
          f"not told: {texts}")
    with_each_ripsctl(fleet, lambda: audited(fleet))


def actuator_goes_back_and_forth(fleet):
    """On a state directory of the other build, without a server and at a robot that was started
    anew, the actuator brings it to the level that it held."""
    fleet.arm()
    compromise(fleet).kill()
    check(fleet.server.kill() == 0, "the server did not end in order")
    for move in (fleet.back, fleet.forward):
        kept = state_of_actuator(fleet)
        check(kept["decided"] == "COMPROMISED", f"{kept}")
        fleet.actuator.kill()
        fleet.robot.kill()
        fleet.robot = fleet.start_robot()
        wait_mode(fleet, "__DEFAULT__")
        move(ACTUATOR)
        fleet.actuator = fleet.start_agent("actuator")
        wait_mode(fleet, "COMPROMISED")
        now = state_of_actuator(fleet)
        check(all(now[name] == kept[name] for name in ("mark", "decided", "highest_term"))
              and now["effective"] == "COMPROMISED", f"from {kept} to {now}")
    fleet.back(ACTUATOR, SENSOR)
    for role in ("actuator", "sensor"):
        getattr(fleet, role).kill()
        setattr(fleet, role, fleet.start_agent(role))
    fleet.server = fleet.start_server()
    fleet.wait_level("COMPROMISED", 40)


def drain_spool_of_other_build(fleet, change):
    """A sensor ends in order while the server is away; after change() one of the other build sends
    what it held. Those judged and those told as lost are all that were sent; gives how many are
    lost."""
    arm_under_load(fleet)
    # It stays when it has sent all: a graph that changes without a connection is a loss.
    load = fleet.start_publisher("--rate", LOAD_RATE, "--count", 16_000)
    load.wait_for(lambda line: '"publishing"' in line, 20, "the publisher is read")
    time.sleep(3)
    lost = metrics(fleet.server)["rips_observations_lost_total"]
    fleet.server.kill(signal.SIGKILL)
    fleet.sensor.child.send_signal(signal.SIGUSR1)
    _, line = load.wait_for(lambda text: '"published"' in text and text, 30, "all is sent")
    sent = json.loads(line)["sent"]
    time.sleep(1)
    check(fleet.sensor.kill() == 0, "the sensor did not end in order")
    spool = fleet.dir / "sensor/spool"
    check(list(spool.glob("*.seg")), "nothing is spooled")

    change()
    fleet.server = fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")
    fleet.sensor.wait_for(lambda line: " streaming " in line, 30, "the sensor streams")
    wait_all_is_judged(fleet, 60)
    judged = judged_messages(fleet)
    lost += metrics(fleet.server)["rips_observations_lost_total"]
    print(f"sent {sent}, judged {sum(judged.values())}, lost {lost:g}")
    check(sum(judged.values()) + lost == sent, f"sent {sent}, judged {judged}, lost {lost:g}")
    check(not list(spool.glob("*.seg")), "segments stay behind")
    return lost


def spool_of_the_previous_sensor(fleet):
    fleet.back(SERVER, SENSOR)
    lost = drain_spool_of_other_build(fleet, lambda: fleet.forward(SERVER, SENSOR))
    check(lost == 0, f"{lost:g} observations are lost")
    texts = texts_of_alerts(fleet)
    check(texts.count("told by a signal") == 1, f"the signal is in {texts}")


def spool_of_a_newer_sensor(fleet):
    """An older sensor may not be able to read it, and then says what is lost."""
    drain_spool_of_other_build(fleet, lambda: fleet.back(SENSOR))


def enrol_and_renew(fleet, first, then):
    """A token brings a robot its certificates by one build of rips-enrol, the other renews them."""
    if not (fleet.previous / "rips-enrol").exists():
        raise Skipped(f"the previous build, {fleet.previous}, has no rips-enrol")
    first("rips-enrol")
    fleet.arm_enrolled()
    before = fleet.serials()
    then("rips-enrol")
    check("not due yet" in fleet.enrol("renew"), "it is due at once")
    fleet.renew()
    renewed = fleet.serials()
    check(all(before[role] != renewed[role] for role in before), f"{before} {renewed}")
    first("rips-enrol")
    fleet.renew()
    after = fleet.serials()
    check(all(renewed[role] != after[role] for role in before), f"{renewed} {after}")
    fleet.wait_level("DEFAULT", 10)
    for role in ("sensor", "actuator"):
        getattr(fleet, role).kill()
        setattr(fleet, role, fleet.start_agent(role))
    fleet.wait_level("DEFAULT", 40)
    eventually(lambda: fleet.connected() == after, 20, "they connect with the new ones")


def new_server_enrols_previous_agents(fleet):
    fleet.back(SENSOR, ACTUATOR)
    enrol_and_renew(fleet, fleet.back, fleet.forward)


def previous_server_enrols_new_agents(fleet):
    fleet.back(SERVER)
    enrol_and_renew(fleet, fleet.forward, fleet.back)


fleet_test.SCENARIOS = [
    new_server_with_previous_agents, previous_server_with_new_agents, upgrade_at_a_raised_level,
    previous_server_on_a_newer_store, going_back_with_the_store_of_before,
    actuator_goes_back_and_forth, spool_of_the_previous_sensor, spool_of_a_newer_sensor,
    new_server_enrols_previous_agents, previous_server_enrols_new_agents]
ENROLLED = (new_server_enrols_previous_agents, previous_server_enrols_new_agents)


if __name__ == "__main__":
    sys.exit(fleet_test.main(
        lambda scenario: SkewedEnrolled if scenario in ENROLLED else Skewed))
