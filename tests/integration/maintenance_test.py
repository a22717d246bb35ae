"""A robot in maintenance, as processes: absent agents are quieter, and nothing else changes.

    maintenance_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import signal
import sys
import time

import fleet_test
from fleet_test import audited, decided, may_lower, until
from fleet import check, page


@may_lower(("rule calm", "ALERT", "DEFAULT"))
def quietens_absence_alone(fleet):
    """Compare with fleet.kill_sensor_in_the_story, which is the same without maintenance."""
    def lost():
        return [each["severity"] for each in fleet.alerts()
                if each["text"].startswith("sensor base is lost")]

    def shown():
        return fleet.level()["maintenance"]
    fleet.arm()
    check(shown() is None, "a maintenance without a call")
    fleet.ripsctl("robot", "maintenance", "r1", "--for", "10min", "--reason", "kernel")
    end = shown()["until"]
    begun = [each for each in fleet.alerts() if " in maintenance until " in each["text"]]
    check([each["severity"] for each in begun] == ["medium"], f"its beginning: {begun}")

    spy = fleet.start_intruder("unknown-node")
    fleet.wait_level("ALERT", 20)
    ruled = [each for each in fleet.alerts() if each["rule"] != "(rips)"]
    check(ruled and all(each["severity"] != "info" and "(asked by alice: kernel)" in
                        each["maintenance"] for each in ruled), f"alerts of rules: {ruled}")

    fleet.sensor.kill(signal.SIGKILL)
    spy.kill()  # no sensor sees it leave
    time.sleep(8)
    check(lost() == ["info"], f"the loss of the sensor: {lost()}")
    check(fleet.level()["decided_level"] == "ALERT", "the level has changed")
    code, _, error = fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--reason", "try",
                                   check=False)
    check(code == 1 and "sensor base is not connected" in error,
          f"a blind lowering was not refused: {code} {error}")
    check("maintenance until " in fleet.ripsctl("robot", "list")[1], "robot list does not show it")
    check('rips_robot_maintenance{robot="r1"} 1' in page(fleet.server, "metrics"), "no metric")

    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()
    check(shown() is not None and shown()["until"] == end, f"after a restart: {shown()}")
    until(fleet, 20, "the sensor is lost for the new server", lambda: len(lost()) == 2)
    check(lost() == ["info", "info"], f"the loss of the sensor: {lost()}")
    check(fleet.level()["decided_level"] == "ALERT", "the level sank with the restart")

    fleet.sensor = fleet.start_agent("sensor")
    fleet.wait_level("DEFAULT", 30)
    check(decided(fleet)[-1]["cause"] == "rule calm", "not lowered by the rule")
    fleet.ripsctl("robot", "maintenance", "r1", "--end", "--reason", "it is back")
    check(shown() is None, "it has not ended")
    fleet.sensor.kill(signal.SIGKILL)
    until(fleet, 20, "the sensor is lost again", lambda: len(lost()) == 3)
    check(lost()[-1] == "high", f"the loss of the sensor after it: {lost()}")

    records = audited(fleet)
    calls = [each for each in records if each["action"] == "SetMaintenance"]
    check([each["outcome"] for each in calls] == ["admitted", "admitted"]
          and "kernel" in calls[0]["text"], f"calls on record: {calls}")
    told = [each["outcome"] for each in records
            if each["kind"] == "alert" and "maintenance" in each["text"]]
    check("medium" in told and "info" in told and "high" not in told, f"on record: {told}")


@may_lower()
def names_who_is_absent_at_its_end(fleet):
    fleet.arm()
    fleet.ripsctl("robot", "maintenance", "r1", "--for", "1min", "--reason", "reboot")
    fleet.sensor.kill(signal.SIGKILL)
    fleet.actuator.kill(signal.SIGKILL)
    for role in ("sensor", "actuator"):
        until(fleet, 20, f"the {role} is lost",
              lambda: [each["severity"] for each in fleet.alerts()
                       if each["text"].startswith(f"{role} base is lost")] == ["info"])
    until(fleet, 70, "its end", lambda: fleet.alerts()[-1]["text"].startswith(
        "still absent after maintenance: sensor base, actuator base; "))
    check(fleet.alerts()[-1]["severity"] == "high", f"its end: {fleet.alerts()[-1]}")
    check(fleet.level()["maintenance"] is None, "it has not ended")


fleet_test.SCENARIOS = [quietens_absence_alone, names_who_is_absent_at_its_end]

if __name__ == "__main__":
    sys.exit(fleet_test.main())
