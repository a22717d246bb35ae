"""A robot under guard beside which an attack runs, and the list of attacks."""

import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
import http2  # noqa: E402
from fleet import SOURCE, Failed, Fleet, check  # noqa: E402

ATTACK_S = float(os.environ.get("RIPS_ATTACK_S", "6"))
MEMORY_MIB = 1024
DISK_MIB = 50
SERVED_S = 2
# From the connection of an agent to the server's answer to its hello.
ADMITTED_S = 2
# From the sending of an observation to the arrival of what the rules order, of a robot that is not
# attacked: 99 of 100, and any. A short run has some 200 verdicts, of which 99 of 100 would be all
# but two: there it is 95 of 100.
VERDICT_P99_S = 0.05
SHARE = 0.99 if ATTACK_S >= 30 else 0.95
VERDICT_S = 2
PROBE_RULES = """
levels: DEFAULT; ALERT;
rules External:
  first: signal("SIGUSR1") ? exec("answer", "1");
  second: signal("SIGUSR2") ? exec("answer", "2");
  unused: false ? trigger(ALERT);
"""
SCENARIOS = {}
QUICK = []


def scenario(function):
    SCENARIOS[function.__name__] = function
    return function


def quick(function):
    """One that tests/run runs."""
    QUICK.append(function.__name__)
    return scenario(function)


def resident_kib(pid):
    for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1])
    raise Failed("the server is gone")


class Guarded(Fleet):
    """A robot under guard, and what it and its operator feel of an attack."""

    # Robots whose keys the attacker has: id -> roles.
    stolen = {}

    def prepare(self):
        super().prepare()
        self.mint("operator", "viewer", "mallory")
        robots = {"probe": ("sensor", "actuator"), "new": ("sensor",), **self.stolen}
        for robot, roles in robots.items():
            for role in roles:
                self.mint(role, robot, "base")
        with open(self.dir / "robots.yaml", "a", encoding="utf-8") as inventory:
            for robot, roles in robots.items():
                actuators = ", actuators: [base]" if "actuator" in roles else ""
                bundle = "probe" if robot in ("probe", "new") else self.bundle
                inventory.write(f"  - {{id: {robot}, bundle: {bundle}, "
                                f"sensors: [{{host: base, primary: true}}]{actuators}}}\n")
        if not (self.dir / "bundles" / self.bundle).exists():
            shutil.copytree(SOURCE / "rules" / self.bundle, self.dir / "bundles" / self.bundle)
        self.write("bundles/probe/probe.rul", PROBE_RULES)
        self.write("bundles/probe/manifest.yaml",
                   "name: probe\nrules: [probe.rul]\nlevels: [DEFAULT, ALERT]\n")
        self.write_server_config(0)  # there is a folder of bundles now

    def arm(self, *limits):
        self.prepare()
        self.robot = self.start_robot()
        self.within = list(limits)
        self.server = self.start_server()
        self.within = []
        self.sensor = self.start_agent("sensor")
        self.actuator = self.start_agent("actuator")
        self.wait_level("DEFAULT", 60)
        self.slowest = 0
        self.disk = self.disk_bytes()
        self.probe = self.start("probe", sys.executable, "-B",
                                pathlib.Path(__file__).with_name("probe.py"), self.port,
                                self.dir / "pki")
        self.probe.wait_for(lambda line: line == "begun", 40, "the first verdict of another robot")
        self.newcomer = self.start("newcomer", sys.executable, "-B",
                                   pathlib.Path(__file__).with_name("newcomer.py"), self.port,
                                   self.dir / "pki/sensor/new/base")

    def key(self):
        return self.dir / "pki/operator/viewer/mallory"

    def attacker(self, source="127.0.0.2"):
        return http2.Client(self.port, self.key(), source)

    def serve_once(self):
        """An operator asks, as one who connects anew."""
        start = time.monotonic()
        self.ripsctl("level", "show", "r1")
        self.slowest = max(self.slowest, time.monotonic() - start)

    def ready(self):
        _, address = self.server.wait_for(
            lambda line: line.partition("metrics=")[2].split(" ")[0], 5, "the page's address")
        try:
            with urllib.request.urlopen(f"http://{address}/readyz", timeout=10) as page:
                return page.status
        except urllib.error.HTTPError as error:
            return error.code

    def run_beside(self, attack):
        """Runs attack() in a thread; an operator asks all the time."""
        trouble = []

        def go():
            try:
                attack()
            except Exception as error:  # noqa: BLE001
                trouble.append(error)

        thread = threading.Thread(target=go, daemon=True)
        thread.start()
        while thread.is_alive():
            self.serve_once()
            time.sleep(0.2)
        if trouble:
            raise trouble[0]

    def disk_bytes(self):
        return sum(path.stat().st_size for path in (self.dir / "server").rglob("*")
                   if path.is_file()) + (self.dir / "policy-server.log").stat().st_size

    def verdicts(self):
        """(p50, SHARE, longest) of robot `probe`, seconds, from before the attack until now."""
        self.probe.kill(signal.SIGTERM, 60)
        got = next((json.loads(line) for _, line in self.probe.lines if line.startswith("{")), None)
        check(got is not None and len(got["seconds"]) > 10, f"no verdicts: {self.probe.lines[-3:]}")
        lost = [line for _, line in self.probe.lines if line.startswith("lost")]
        check(not lost, f"a stream of another robot was lost: {lost[:5]}")
        times = sorted(got["seconds"])
        return times[len(times) // 2], times[int(SHARE * (len(times) - 1))], times[-1]

    def newcomers(self):
        """How long each new agent waited until it was admitted, seconds, until now."""
        self.newcomer.kill(signal.SIGTERM, 60)
        got = next((json.loads(line) for _, line in self.newcomer.lines if line.startswith("{")),
                   None)
        check(got is not None and len(got["seconds"]) > 1,
              f"no new agent was admitted: {self.newcomer.lines[-3:]}")
        return got["seconds"]

    def bounded(self):
        """What another robot and the machine felt is within bounds; printed for the table in
        README.md."""
        p50, p99, longest = self.verdicts()
        admitted = self.newcomers()
        memory_mib = resident_kib(self.server.child.pid) >> 10
        disk_mib = (self.disk_bytes() - self.disk) / (1 << 20)
        print(f"measured: | {1_000 * p50:.1f} | {1_000 * p99:.1f} | {1_000 * longest:.0f} | "
              f"{1_000 * max(admitted):.0f} | {memory_mib} | {disk_mib:.1f} |  (verdicts of another "
              f"robot: p50, p99 and longest; the longest wait of {len(admitted)} new agents, all in "
              "ms; the server's memory and disk in MiB)")
        check(p99 <= VERDICT_P99_S and longest <= VERDICT_S,
              f"verdicts of another robot took {p99:.3f} s (p99) and {longest:.3f} s (longest)")
        check(max(admitted) <= ADMITTED_S, f"a new agent waited {max(admitted):.1f} s")
        check(memory_mib < MEMORY_MIB, f"the server took {memory_mib} MiB")
        check(disk_mib < DISK_MIB, f"the disk grew by {disk_mib:.0f} MiB")

    def unharmed(self):
        self.bounded()
        for _ in range(3):
            self.serve_once()
        check(self.ready() == 200, "/readyz is not 200 after the attack")
        check(self.slowest <= SERVED_S, f"an operator waited {self.slowest:.1f} s")
        status = self.level()
        check(status["effective_level"] == "DEFAULT" and status["stage"] == "verified",
              f"the robot felt it: {status}")
        lost = [line for _, line in self.actuator.lines if "lease expired" in line]
        check(not lost, f"the actuator lost its lease: {lost}")
        told = [a["text"] for a in self.alerts()]
        harm = [text for text in told
                if "second process" in text or ("lost" in text and "state lost" not in text)]
        check(not harm, f"the robot's agents felt it: {harm}")
        print(f"operator served in {self.slowest:.2f} s at worst")

    def server_alerts(self):
        """Texts of the alerts that are no robot's."""
        found = self.query("alert", "list", "--limit", "1000")["alerts"]
        return [a["text"] for a in found if a["robot"] == "(server)"]

    def told_of(self, robot, part):
        """The robot whose key the attacker uses has an alert that says so."""
        texts = [a["text"] for a in self.query("alert", "list", robot, "--limit", "1000")["alerts"]]
        check(any(part in text for text in texts), f"no alert of {robot} says {part!r}: {texts}")

    def named(self, address, certificate=None):
        """The alert names the attacker."""
        texts = self.server_alerts()
        check(any(address in text for text in texts), f"no alert names {address}: {texts}")
        if certificate:
            check(any(certificate in text for text in texts),
                  f"no alert names {certificate}: {texts}")


def run_ripsctl_as(fleet, pki):
    done = subprocess.run(
        [str(fleet.bin / "ripsctl"), "--server", f"127.0.0.1:{fleet.port}", "--ca",
         f"{pki}/ca.pem", "--cert", f"{pki}/cert.pem", "--key", f"{pki}/key.pem", "robot", "list"],
        capture_output=True, text=True, timeout=30, env=fleet.env)
    return done.returncode, done.stdout, done.stderr
