"""Alerts of the host's intrusion detection system reach the rules of a live robot, each once.

    ids_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time
import uuid

import fleet_test
from fleet_test import Failed, Skipped, check
from network import need_namespaces

RULES = """
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
rules External:
  sweep: idsalert("1:1000003") ?
    alert("swept by " + IdsSource + " to " + IdsTarget, "high") => trigger(ALERT);
  marker: idsalert("RIPS marker") ? alert("marked", "high") => trigger(COMPROMISED);
  each: idsalert("RIPS count") ? alert("counted", "info");
  lost: lostevents(1) ? alert("events were lost", "info");
  never: false ? trigger(HALT);
"""


def use_rules(fleet):
    fleet.bundle = "external"
    fleet.write("bundles/external/manifest.yaml",
                "name: external\nrules: [external.rul]\n"
                "levels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
    fleet.write("bundles/external/external.rul", RULES)


def follow(fleet, form, log):
    """The sensor's configuration names the log."""
    plain = fleet.write_agent_configs

    def with_ids():
        plain()
        with open(fleet.dir / "sensor.yaml", "a", encoding="utf-8") as config:
            config.write(f"ids: [{{format: {form}, path: {log}}}]\n")
    fleet.write_agent_configs = with_ids


def wait_for(what, condition, seconds=30):
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise Failed(f"not within {seconds} s: {what}")
        time.sleep(0.05)


def texts(fleet, rule):
    return [each["text"] for each in fleet.alerts() if each["rule"] == rule]


# ------------------------------------------------------------------------------------ scenarios


def fast_line(sid, message):
    return (f"11/21/2026-10:11:12.123456  [**] [1:{sid}:1] {message} [**] [Priority: 1] {{TCP}} "
            "10.0.0.9:4444 -> 10.0.0.1:80\n")


def alerts_are_judged_once(fleet):
    """Over the death of the sensor and of the server, rotation of the log, and both at once."""
    log = fleet.dir / "ids/fast.log"
    log.parent.mkdir()
    log.write_text(fast_line(1, "RIPS marker") + fast_line(1000003, "RIPS port sweep"))  # old
    use_rules(fleet)
    follow(fleet, "fast", log)
    fleet.arm()
    wait_for("the sensor has begun", (fleet.dir / "sensor/ids-offsets").exists)

    def append(text):
        with open(log, "a", encoding="utf-8") as file:
            file.write(text)

    def counted(count):
        wait_for(f"{count} alerts", lambda: len(texts(fleet, "each")) >= count)

    def settled():
        """What was acknowledged is noted within a second; then nothing is in doubt."""
        wait_for("the acknowledgement is noted", lambda: "\nunacknowledged 0\n" in
                 (fleet.dir / "sensor/ids-offsets").read_text())

    append(fast_line(1000003, "RIPS port sweep"))
    fleet.wait_level("ALERT", 20)
    check(texts(fleet, "sweep") == ["swept by 10.0.0.9 to 10.0.0.1"], texts(fleet, "sweep"))

    append(fast_line(5, "RIPS count 1"))
    counted(1)
    settled()
    fleet.sensor.kill(signal.SIGKILL)
    append(fast_line(5, "RIPS count 2"))
    os.rename(log, f"{log}.1")
    append(fast_line(5, "RIPS count 3"))
    fleet.sensor = fleet.start_agent("sensor")
    counted(3)

    settled()
    fleet.server.kill(signal.SIGKILL)
    fleet.sensor.wait_for(lambda line: "no stream to the policy server" in line, 30,
                          "the sensor misses the server")
    append(fast_line(5, "RIPS count 4"))
    fleet.sensor.kill(signal.SIGKILL)  # in the log only, or read and not sent
    append(fast_line(5, "RIPS count 5"))
    fleet.sensor = fleet.start_agent("sensor")
    append(fast_line(5, "RIPS count 6"))
    fleet.server = fleet.start_server()
    counted(6)

    append(fast_line(5, "RIPS marker"))
    fleet.wait_level("COMPROMISED", 20)
    check(texts(fleet, "each") == ["counted"] * 6, f"counted {texts(fleet, 'each')}")
    check(len(texts(fleet, "sweep")) == 1 and len(texts(fleet, "marker")) == 1, fleet.alerts())
    # Each process that was killed may have held something, and the next one says so.
    check(len(texts(fleet, "lost")) == 2, f"losses: {texts(fleet, 'lost')}")
    check(fleet.sensor.kill(signal.SIGTERM) == 0, "the sensor does not end well")


def truncated_logs(fleet):
    """A nightly rotation whose copy goes elsewhere is no loss; alerts that were not read when the log
    was truncated are."""
    log = fleet.dir / "ids/fast.log"
    log.parent.mkdir()
    log.write_text("")
    elsewhere = fleet.dir / "copy.log"
    use_rules(fleet)
    follow(fleet, "fast", log)
    fleet.arm()
    wait_for("the sensor has begun", (fleet.dir / "sensor/ids-offsets").exists)
    with open(log, "a", encoding="utf-8") as ids:
        def write(message):
            ids.write(fast_line(5, message))
            ids.flush()

        def counted(count):
            wait_for(f"{count} alerts", lambda: len(texts(fleet, "each")) >= count)

        def metric(name):
            counted = re.findall(rf"^rips_sensor_ids_{name}_total\{{.*\}} (\d+)",
                                 fleet_test.page(fleet.sensor, "metrics"), re.MULTILINE)
            return int(counted[0])

        for night in range(1, 4):
            write(f"RIPS count {night}")
            counted(night)
            shutil.copy(log, elsewhere)
            os.truncate(log, 0)
        write("RIPS count 4")
        counted(4)
        check(not texts(fleet, "lost"), f"losses: {texts(fleet, 'lost')}")

        pid = fleet.sensor.child.pid
        os.kill(pid, signal.SIGSTOP)  # a host that is busy with something else
        wait_for("all threads stand still", lambda: all(
            ") T " in stat.read_text()
            for stat in pathlib.Path(f"/proc/{pid}/task").glob("*/stat")))
        write("RIPS count, never read")
        shutil.copy(log, elsewhere)
        os.truncate(log, 0)
        write("RIPS count 5")
        os.kill(pid, signal.SIGCONT)
        counted(5)
        wait_for("the loss", lambda: texts(fleet, "lost"), 10)
        check(metric("gaps") == 1, f"{metric('gaps')} gaps")
        check(metric("truncated") == 4, f"{metric('truncated')} truncations")
        check(len(texts(fleet, "each")) == 5, texts(fleet, "each"))


SURICATA = """%YAML 1.1
---
vars:
  address-groups: {{HOME_NET: any, EXTERNAL_NET: any}}
af-packet:
  - {{interface: {interface}, threads: 1, cluster-id: 99, cluster-type: cluster_flow}}
outputs:
  - eve-log: {{enabled: yes, filetype: regular, filename: eve.json, types: [alert, flow, stats]}}
stats: {{enabled: yes, interval: 1}}
unix-command: {{enabled: no}}
logging:
  outputs: [console: {{enabled: yes}}]
"""

SURICATA_RULES = """
alert tcp any any -> 10.98.0.1 any (msg:"RIPS port sweep"; flags:S; threshold:type both, track by_src, count 5, seconds 60; sid:1000003; rev:2;)
alert udp any any -> 10.98.0.1 any (msg:"RIPS marker"; content:"RTPS"; depth:4; threshold:type limit, track by_src, count 1, seconds 60; sid:1000004; rev:1;)
"""

PEER = """
import socket, sys
if sys.argv[1] == "sweep":
    for port in range(1, 40):
        with socket.socket() as peer:
            peer.settimeout(2)
            peer.connect_ex(("10.98.0.1", port))
else:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        for _ in range(3):
            peer.sendto(b"RTPS" + bytes(16), ("10.98.0.1", 7400))
"""


class Network:
    """Two hosts on one wire, apart from everything else on this machine."""

    def __init__(self):
        name = f"rips-ids-{uuid.uuid4().hex[:6]}"
        self.robot, self.peer = f"{name}-r", f"{name}-p"

    def __enter__(self):
        try:
            self._ip("netns", "add", self.robot)
            self._ip("netns", "add", self.peer)
            self._ip("-n", self.robot, "link", "add", "wire", "type", "veth", "peer", "name",
                     "wire", "netns", self.peer)
            for space, address in ((self.robot, "10.98.0.1/24"), (self.peer, "10.98.0.2/24")):
                self._ip("-n", space, "addr", "add", address, "dev", "wire")
                self._ip("-n", space, "link", "set", "wire", "up")
                self._ip("-n", space, "link", "set", "lo", "up")
        except Failed:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        for space in (self.robot, self.peer):
            subprocess.run(["ip", "netns", "del", space], stderr=subprocess.DEVNULL, check=False)

    @staticmethod
    def _ip(*args):
        done = subprocess.run(["ip", *args], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise Failed(f"ip {' '.join(args)}: {done.stderr.strip()}")

    def attack(self, what):
        subprocess.run(["ip", "netns", "exec", self.peer, sys.executable, "-c", PEER, what],
                       check=True, timeout=120)


def suricata_sees_live_traffic(fleet):
    """A real Suricata on a wire between two hosts; its log is rotated in between."""
    need_namespaces()
    if shutil.which("suricata") is None:
        raise Skipped("suricata is not installed (deploy/install-packages)")
    logs = fleet.dir / "ids"
    logs.mkdir()
    use_rules(fleet)
    follow(fleet, "eve", logs / "eve.json")
    config = fleet.write("suricata.yaml", SURICATA.format(interface="wire"))
    rules = fleet.write("suricata.rules", SURICATA_RULES)
    with Network() as network:
        suricata = fleet.start("suricata", "ip", "netns", "exec", network.robot, "suricata", "-c",
                               config, "-S", rules, "-l", logs, "--af-packet=wire")
        fleet.arm()
        suricata.wait_for(lambda line: "ngine started" in line, 60, "Suricata starts")

        begun = time.monotonic()
        network.attack("sweep")
        fleet.wait_level("ALERT", 30)
        print(f"ALERT {time.monotonic() - begun:.2f} s after the sweep began")
        check(texts(fleet, "sweep") == ["swept by 10.98.0.2 to 10.98.0.1"], texts(fleet, "sweep"))

        os.rename(logs / "eve.json", logs / "eve.json.1")
        os.kill(suricata.child.pid, signal.SIGHUP)  # as logrotate does
        wait_for("a new log", lambda: (logs / "eve.json").exists())
        network.attack("marker")
        fleet.wait_level("COMPROMISED", 30)

        check(texts(fleet, "sweep") == ["swept by 10.98.0.2 to 10.98.0.1"], texts(fleet, "sweep"))
        check(texts(fleet, "marker") == ["marked"], texts(fleet, "marker"))
        check(not texts(fleet, "lost"), f"losses: {texts(fleet, 'lost')}")
        seen = [json.loads(line) for name in ("eve.json.1", "eve.json")
                for line in (logs / name).read_text().splitlines()]
        check(any(each["event_type"] != "alert" for each in seen), "the log has only alerts")
        suricata.kill(seconds=30)


fleet_test.SCENARIOS = [alerts_are_judged_once, truncated_logs, suricata_sees_live_traffic]

if __name__ == "__main__":
    sys.exit(fleet_test.main())
