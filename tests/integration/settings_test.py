"""Settings of a sensor that come from the policy server's inventory.

    settings_test.py BINARIES SCENARIO         runs one; without SCENARIO prints their names
"""

import signal
import subprocess
import sys
import time

import fleet_test
from fleet_test import compromise, decided, until
from fleet import check


def said(fleet):
    """What the sensor follows, by path: value and source; and what it refuses."""
    agents = fleet.query("robot", "config", fleet.robot_id)["agents"]
    sensor = next(each for each in agents if each["role"] == "sensor")["configuration"]
    if sensor is None:  # it has not connected since the server's start
        sensor = {"settings": [], "refused": []}
    return ({each["path"]: (each["value"], each["source"]) for each in sensor["settings"]},
            sensor["refused"])


def set_in_inventory(fleet, settings):
    """Without a reload."""
    robots = "robots:" + (fleet.dir / "robots.yaml").read_text().partition("robots:")[2]
    fleet.write("robots.yaml",
                (f"sensor_settings: [{{set: {settings}}}]\n" if settings else "") + robots)


def reload(fleet, settings):
    set_in_inventory(fleet, settings)
    fleet.server.child.send_signal(signal.SIGHUP)


def follows_the_inventory(fleet):
    """Where its file allows it, at once, in the same process, without a level that moves; and still
    after a restart while the server is away."""
    fleet.sensor_options = "server_may_set: [settle, unwatched]\n"
    fleet.arm()
    compromise(fleet)
    levels = len(decided(fleet))
    process = fleet.sensor.child.pid
    check(said(fleet)[0].get("settle") == ("2s", None), f"at first: {said(fleet)}")

    reload(fleet, "{settle: 3s, signals: false}")
    until(fleet, 20, "it follows", lambda: said(fleet)[0]["settle"][0] == "3s")
    settings, refused = said(fleet)
    where = f"policy server, {fleet.dir}/robots.yaml:1"
    check(settings["settle"] == ("3s", where), f"{settings['settle']}, not from {where}")
    check(settings["signals"] == ("true", None), f"not allowed, and set: {settings['signals']}")
    check(refused == [f"`signals: false` ({where}): `server_may_set` of {fleet.dir}/sensor.yaml "
                      "does not list it"], f"refused: {refused}")
    check("not followed: `signals: false`" in fleet.ripsctl("robot", "config", "r1")[1],
          "an operator does not see what is refused")
    until(fleet, 10, "an alert tells of the change", lambda: any(
        "other settings for sensors of 1 robot: r1" in each["text"]
        for each in fleet.query("alert", "list")["alerts"]))
    check(fleet.sensor.child.pid == process and fleet.sensor.running, "the process has ended")
    fleet.wait_level("COMPROMISED", 20)
    check(len(decided(fleet)) == levels, f"a level has moved: {decided(fleet)[levels:]}")

    fleet.server.kill()
    fleet.sensor.kill()
    fleet.sensor = fleet.start_agent("sensor")
    checked = subprocess.run([fleet.bin / "rips-sensor", "--config", fleet.dir / "sensor.yaml",
                              "--check-config"], capture_output=True, text=True, env=fleet.env)
    check(f"settle: 3s  # {where}\n" in checked.stdout, f"not kept: {checked.stdout}")
    check("`signals: false`" in checked.stderr, f"what is refused is no warning: {checked.stderr}")
    fleet.server = fleet.start_server()
    until(fleet, 20, "still", lambda: said(fleet)[0].get("settle") == ("3s", where))

    reload(fleet, None)
    until(fleet, 20, "the file's again", lambda: said(fleet)[0].get("settle") == ("2s", None))
    check(said(fleet)[1] == [], f"refused: {said(fleet)[1]}")
    fleet.wait_level("COMPROMISED", 20)
    check(len(decided(fleet)) == levels, f"a level has moved: {decided(fleet)[levels:]}")


def one_that_follows_nothing_goes_on(fleet):
    """It says so and is not disturbed, however often the inventory changes."""
    fleet.arm()
    for i in range(4):
        reload(fleet, f"{{settle: {3 + i}s}}")
        until(fleet, 20, "it says so", lambda: f"settle: {3 + i}s" in "".join(said(fleet)[1]))
    check(said(fleet)[0]["settle"] == ("2s", None), f"it follows: {said(fleet)[0]['settle']}")
    check(not any("beginning to watch anew" in line for _, line in fleet.sensor.lines),
          "it has begun anew")
    raised = [each["text"] for each in fleet.alerts() if each["text"].startswith("sensor base")]
    check(not raised, f"alerts: {raised}")


def changes_once_a_minute(fleet):
    """An inventory that is edited again and again does not keep a robot without its sensor, and a
    reload that changes nothing of the settings disturbs nothing."""
    fleet.sensor_options = "server_may_set: [settle]\n"
    fleet.arm()
    reload(fleet, "{settle: 3s}")
    until(fleet, 20, "it follows", lambda: said(fleet)[0]["settle"][0] == "3s")

    def begun():
        return sum("beginning to watch anew" in line for _, line in fleet.sensor.lines)
    check(begun() == 1, f"begun anew {begun()} times")
    for i in range(6):
        reload(fleet, f"{{settle: {4 + i % 2}s}}")
        time.sleep(1)
    check(begun() == 1, f"begun anew {begun()} times within a minute")
    check(any("following them later" in line for _, line in fleet.sensor.lines),
          "its log does not say that it waits")
    set_in_inventory(fleet, "{settle: 3s}")
    inventory = (fleet.dir / "robots.yaml").read_text()
    fleet.write("robots.yaml", "# One more line, so that it stands elsewhere.\n" + inventory)
    fleet.server.child.send_signal(signal.SIGHUP)
    time.sleep(60)
    check(begun() == 1, "begun anew with the settings that it followed")
    reload(fleet, "{settle: 1s}")
    until(fleet, 20, "it follows", lambda: said(fleet)[0]["settle"][0] == "1s")


fleet_test.SCENARIOS = [follows_the_inventory, one_that_follows_nothing_goes_on, changes_once_a_minute]

if __name__ == "__main__":
    sys.exit(fleet_test.main())
