"""One robot of two hosts, each with a sensor and an actuator, on a real server; and a server that is
stopped in order.

    hosts_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import json
import pathlib
import signal
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from fleet import Failed, Fleet  # noqa: E402
import fleet_test  # noqa: E402
from fleet_test import check, decided, may_lower  # noqa: E402

RULES = """
levels:
  DEFAULT;
  ALERT;
  COMPROMISED;
  HALT;
rules External:
  told: signal("SIGUSR1") ? alert("told by a signal");
  unused: false ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);
rules Msg:
  spoken: topicmatches("^/load") && msgcount(2000, 50, 1000000) ? alert("messages come");
"""


FINDING_RULES = """
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
rules External:
  found: CurrLevel < ALERT && findingstands("impostor") ? trigger(ALERT);
  calm: CurrLevel == ALERT && !findingstands("any") ? trigger(DEFAULT);
  unused: false ? trigger(COMPROMISED), trigger(HALT);
"""


class TwoHosts(Fleet):
    """Robot `r1` with the hosts `base`, whose sensor is the primary one, and `laptop`."""

    rules = RULES

    def prepare(self):
        self.bundle = "hosts"
        self.write("bundles/hosts/manifest.yaml",
                   "name: hosts\nrules: [r.rul]\nlevels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
        self.write("bundles/hosts/r.rul", self.rules)
        super().prepare()
        self.mint("sensor", "r1", "laptop")
        self.mint("actuator", "r1", "laptop")
        self.write("robots.yaml", f"""robots:
  - {{id: r1, bundle: {self.bundle}, sensors: [{{host: base, primary: true}}, {{host: laptop}}],
     actuators: [base, laptop]}}
""")

    def start_on_laptop(self, role):
        self.write_agent_configs()
        directory = self.dir / f"{role}-laptop"
        directory.mkdir(exist_ok=True)
        text = (self.dir / f"{role}.yaml").read_text()
        for old, new in (("host: base", "host: laptop"), (f"/{role}/r1/base", f"/{role}/r1/laptop"),
                         (f"state_dir: {self.dir}/{role}", f"state_dir: {directory}")):
            check(old in text, f"{role}.yaml has no `{old}`")
            text = text.replace(old, new)
        config = self.write(f"{role}-laptop.yaml", text)
        ready = directory / "ready"
        ready.unlink(missing_ok=True)
        agent = self.start(f"{role}-laptop", self.bin / f"rips-{role}", "--config", config,
                           "--ready-file", ready)
        self._ready(agent, ready, f"the {role} of laptop")
        return agent

    def arm(self, *robot_options, seconds=40):
        self.prepare()
        self.robot = self.start_robot(*robot_options)
        self.server = self.start_server()
        self.sensor = self.start_agent("sensor")
        self.actuator = self.start_agent("actuator")
        self.second_sensor = self.start_on_laptop("sensor")
        self.second_actuator = self.start_on_laptop("actuator")
        return self.wait_level("DEFAULT", seconds)

    def told(self, text):
        return [alert["text"] for alert in self.alerts() if text in alert["text"]]

    def wait_told(self, text, seconds=20):
        deadline = time.monotonic() + seconds
        while not self.told(text):
            if time.monotonic() > deadline:
                raise Failed(f"`{text}` is not told: {self.told('')}")
            time.sleep(0.2)


class ShortLeases(Fleet):
    """Leases of 3 s, and of 14 s from a server that stops."""

    def write_server_config(self, port):
        super().write_server_config(port)
        with open(self.dir / "policy-server.yaml", "a", encoding="utf-8") as config:
            config.write("timing: {heartbeat: 200ms, stale: 600ms, lost: 2s, lease: 3s, "
                         "drain_lease: 14s}\n")


# ------------------------------------------------------------------------------------ scenarios


@may_lower(("operator alice", "ALERT", "DEFAULT"))
def verified_only_when_both_are(fleet):
    """A level is verified when both actuators hold it; one that is lost is told, and the level is
    not lowered unseen."""
    fleet.arm()
    fleet.second_actuator.child.send_signal(signal.SIGSTOP)
    fleet.ripsctl("level", "raise", "r1", "--to", "ALERT", "--reason", "try")
    deadline = time.monotonic() + 3
    while time.monotonic() < deadline:
        status = fleet.level()
        check(status["decided_level"] == "ALERT" and status["stage"] != "verified",
              f"verified by one of two: {status}")
        time.sleep(0.1)
    check(fleet.mode()["mode"] == "ALERT", "the other actuator waits for the first")
    fleet.second_actuator.child.send_signal(signal.SIGCONT)
    fleet.wait_level("ALERT", 20)

    fleet.second_actuator.kill(signal.SIGKILL)
    fleet.wait_told("actuator laptop is lost")
    status = fleet.level()
    check(status["stage"] != "verified", f"verified although an actuator is lost: {status}")
    check(any("laptop" in text for text in status["degraded"]), f"not degraded: {status}")
    check(status["effective_level"] == "ALERT", f"the other does not hold it: {status}")
    code, _, error = fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--reason", "try",
                                   check=False)
    check(code == 1 and "actuator laptop holds no live lease" in error,
          f"a blind lowering was not refused: {code} {error}")

    fleet.second_actuator = fleet.start_on_laptop("actuator")
    fleet.wait_level("ALERT", 20)
    fleet.wait_told("actuator laptop is back")
    fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--reason", "both are there")
    fleet.wait_level("DEFAULT", 20)


def second_sensor_adds_what_its_host_sees(fleet):
    """The graph and the messages are the primary's, once; the other's signals are judged; and
    without it the robot is blind."""
    fleet.arm()
    load = fleet.start_publisher("--rate", 100)
    load.wait_for(lambda line: '"publishing"' in line, 20, "the publisher is read")
    fleet.wait_told("messages come")
    load.kill()
    fleet.second_sensor.child.send_signal(signal.SIGUSR1)
    fleet.wait_told("told by a signal")
    fleet.sensor.child.send_signal(signal.SIGUSR1)
    deadline = time.monotonic() + 20
    while len(fleet.told("told by a signal")) < 2:
        check(time.monotonic() < deadline, "a signal of the primary is not told")
        time.sleep(0.2)
    _, out, _ = fleet.ripsctl("signal", "send", "r1", "usr1", "--reason", "a third")
    check("judged SIGUSR1; its level is DEFAULT" in out, out)
    fleet.wait_told("sends SIGUSR1 to r1: a third")
    by_hand = [alert["event"] for alert in fleet.alerts() if "told by a signal" in alert["text"]]
    check([event for event in by_hand if " sent by operator " in event], f"not told: {by_hand}")

    fleet.second_sensor.kill(signal.SIGKILL)
    fleet.wait_told("sensor laptop is lost")
    fleet.server.wait_for(lambda line: " alert " in line and "sensor laptop is lost" in line, 10,
                          "the log says so, too")
    fleet.ripsctl("level", "raise", "r1", "--to", "ALERT", "--reason", "try")
    fleet.wait_level("ALERT", 20)
    code, _, error = fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--reason", "try",
                                   check=False)
    check(code == 1 and "sensor laptop is not connected" in error,
          f"a blind lowering was not refused: {code} {error}")
    fleet.second_sensor = fleet.start_on_laptop("sensor")
    fleet.wait_told("sensor laptop is back")


def four_processes_are_one_node_and_no_impostors(fleet):
    """Two sensors and two actuators announce `/rips`: none is a finding, whoever is started again,
    before or behind whom, also while the server is away; a fifth that does so is one."""
    fleet.arm()
    time.sleep(7)  # longer than the grace for those that the server does not name
    for name in ("second_actuator", "second_sensor"):
        getattr(fleet, name).kill(signal.SIGKILL)
        setattr(fleet, name, fleet.start_on_laptop(name.removeprefix("second_")))
    fleet.actuator.kill(signal.SIGKILL)
    fleet.actuator = fleet.start_agent("actuator")
    fleet.sensor.kill()
    fleet.sensor = fleet.start_agent("sensor")
    fleet.wait_level("DEFAULT", 30)
    time.sleep(7)
    fleet.server.kill(signal.SIGKILL)
    fleet.second_actuator.kill(signal.SIGKILL)
    fleet.second_actuator = fleet.start_on_laptop("actuator")
    time.sleep(3)
    fleet.server = fleet.start_server()
    fleet.wait_level("DEFAULT", 40)
    time.sleep(7)
    check(not fleet.told("finding "), f"told without a reason: {fleet.told('finding ')}")

    fleet.start_intruder("unknown-node", "--node", "/rips")
    fleet.wait_told("finding impostor")
    check(len(fleet.told("finding impostor")) == 1, f"{fleet.told('finding ')}")


@may_lower(("rule calm", "ALERT", "DEFAULT"), ("rule calm", "ALERT", "DEFAULT"))
def rules_leave_a_level_when_nothing_found_is_left(fleet):
    """A rule raises the level while an impostor is there, and lowers it when no sensor finds
    anything: not while one of them may find more, nor before a server that was started anew has
    heard of what stands from both."""
    fleet.rules = FINDING_RULES
    started = time.monotonic()
    fleet.arm()

    def known():
        return json.loads(fleet.ripsctl("--output", "json", "explain", "r1")[1])["findings"]

    impostor = fleet.start_intruder("unknown-node", "--node", "/rips")
    fleet.wait_level("ALERT", 30)
    impostor.kill()
    fleet.server.wait_for(lambda line: "no longer: finding impostor" in line, 30,
                          "the end of the finding is on record")
    now = known()
    check(now["total"] == 0 and any("laptop" in why for why in now["not_known_because"]), f"{now}")
    check(fleet.level()["decided_level"] == "ALERT", "lowered although more may be found")
    fleet.wait_level("DEFAULT", 100)
    check(time.monotonic() - started > 60, "lowered within a minute of the sensors' start")

    impostor = fleet.start_intruder("unknown-node", "--node", "/rips")
    fleet.wait_level("ALERT", 30)
    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()
    fleet.wait_level("ALERT", 40)
    deadline = time.monotonic() + 30
    now = known()
    while now["not_known_because"]:
        check(time.monotonic() < deadline, f"not all is known: {now}")
        time.sleep(2)  # an operator may ask so often only
        now = known()
    check(now["total"] == 1, f"the impostor does not stand: {now}")
    check(fleet.level()["decided_level"] == "ALERT", "lowered while it stands")
    impostor.kill()
    fleet.wait_level("DEFAULT", 60)


def server_that_stops_grants_time(fleet):
    """SIGTERM grants the drain lease: the robot stays where it is for longer than a lease, and
    takes its fail-safe level when that time is over, too."""
    fleet.arm()
    before = decided(fleet)
    for _ in range(3):
        stopped = time.monotonic()
        start = len(fleet.actuator.lines)
        check(fleet.server.kill() == 0, "the server did not end in order")
        check(time.monotonic() - stopped < 8, "it took its time to stop")
        time.sleep(max(0.0, 7 - (time.monotonic() - stopped)))  # leases are of 3 s
        raised = [text for _, text in fleet.actuator.lines[start:] if "floor=ALERT" in text]
        check(not raised, f"the actuator raised its floor: {raised}")
        check(fleet.mode()["mode"] == "__DEFAULT__", "the robot left its mode")
        fleet.server = fleet.start_server()
        fleet.wait_level("DEFAULT", 30)
    check([d["decision_id"] for d in decided(fleet)] == [d["decision_id"] for d in before], "decisions changed")

    start = len(fleet.actuator.lines)
    stopped = time.monotonic()
    check(fleet.server.kill() == 0, "the server did not end in order")
    fleet.actuator.wait_for(lambda line: "floor=ALERT" in line, 25, "the drain lease ends",
                            start=start)
    lasted = time.monotonic() - stopped
    check(11 < lasted < 22, f"the drain lease of 14 s lasted {lasted:.1f} s")
    fleet.server = fleet.start_server()
    fleet.wait_level("DEFAULT", 30)


fleet_test.SCENARIOS = [verified_only_when_both_are, second_sensor_adds_what_its_host_sees,
                        four_processes_are_one_node_and_no_impostors,
                        rules_leave_a_level_when_nothing_found_is_left,
                        server_that_stops_grants_time]
KINDS = {server_that_stops_grants_time: ShortLeases}

if __name__ == "__main__":
    sys.exit(fleet_test.main(lambda scenario: KINDS.get(scenario, TwoHosts)))
