"""Real disks that are full or have become read-only, each in a mount namespace of the daemon that
uses it: a small ext4 file system in a file. Needs root.

    disks_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from fleet import Failed, Fleet, metrics  # noqa: E402
import fleet_test  # noqa: E402
from fleet_test import (  # noqa: E402
    Skipped, arm_under_load, check, decided, judged_messages, may_lower, published,
    wait_all_is_judged)

RULES = """
levels:
  DEFAULT;
  ALERT;
  COMPROMISED;
  HALT;
rules External:
  first: signal("SIGUSR1") && CurrLevel < ALERT ? trigger(ALERT);
  note: signal("SIGUSR1") ? alert("%s");
  second: signal("SIGUSR2") && CurrLevel < COMPROMISED ? trigger(COMPROMISED);
  said: signal("SIGUSR2") ? alert("the second signal has come");
  unused: false ? trigger(HALT);
""" % ("long " * 150)
DISK_BYTES = 24 << 20


class Disk:
    """An ext4 file system in a file, seen by one process at a time."""

    def __init__(self, directory, name, size=DISK_BYTES):
        self.image = pathlib.Path(directory) / f"{name}.img"
        self.mount = pathlib.Path(directory) / name
        self.mount.mkdir(exist_ok=True)
        with open(self.image, "wb") as image:
            image.truncate(size)
        done = subprocess.run(["mkfs.ext4", "-q", "-F", "-m", "0", self.image],
                              capture_output=True, text=True)
        if done.returncode != 0:
            raise Skipped(f"mkfs.ext4 does not work here: {done.stderr.strip()}")
        done = subprocess.run([*self.within(), "true"], capture_output=True, text=True)
        if done.returncode != 0:
            raise Skipped(f"file systems cannot be mounted here: {done.stderr.strip()}")
        self.pid = None

    def within(self):
        """What a command begins with that sees the disk; who had it before may still be going."""
        return ["unshare", "--mount", "--propagation", "private", "sh", "-c",
                f'n=0; until mount -o loop,errors=remount-ro "{self.image}" "{self.mount}"; do '
                'n=$((n + 1)); [ $n -lt 30 ] || exit 1; sleep 0.1; done; exec "$@"', "sh"]

    def start(self, fleet, begin):
        """Starts a daemon by begin(); it has the disk."""
        fleet.within = self.within()
        try:
            process = begin()
        finally:
            fleet.within = []
        self.pid = process.child.pid
        return process

    def path(self, name=""):
        """Of a file, as this process finds it."""
        return pathlib.Path(f"/proc/{self.pid}/root{self.mount}") / name

    def fill(self):
        with open(self.path("filler"), "wb", buffering=0) as filler:
            for size in (1 << 16, 1 << 10, 1):
                try:
                    while True:
                        filler.write(b"x" * size)
                except OSError as error:
                    check("No space" in str(error), f"not full, but: {error}")
        check(os.statvfs(self.path()).f_bavail == 0, "there is room left")

    def free(self):
        self.path("filler").unlink()

    def break_it(self):
        """As after an error of the device: read-only for what is open, too, until it is mounted
        anew."""
        subprocess.run(["nsenter", "-t", str(self.pid), "-m", "mount", "-o", "remount,abort",
                        self.mount], check=True)
        try:
            self.path("probe").write_text("x")
        except OSError:
            return
        raise Failed("the disk can still be written")


class OnDisks(Fleet):
    """The store, and the actuator's state, in directories of their own."""

    def prepare(self):
        if os.geteuid() != 0:
            raise Skipped("only root may mount file systems")
        if self.bundle == "warehouse":
            self.bundle = "disks"
            self.write("bundles/disks/manifest.yaml",
                       "name: disks\nrules: [r.rul]\nlevels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
            self.write("bundles/disks/r.rul", RULES)
        super().prepare()
        for name in ("store", "state"):
            (self.dir / name).mkdir()

    def write_server_config(self, port):
        super().write_server_config(port)
        self._move("policy-server.yaml", f"path: {self.dir}/server/state.db",
                   f"path: {self.dir}/store/state.db")

    def write_agent_configs(self):
        super().write_agent_configs()
        self._move("actuator.yaml", f"state_dir: {self.dir}/actuator\n",
                   f"state_dir: {self.dir}/state\n")

    def _move(self, name, old, new):
        text = (self.dir / name).read_text()
        check(old in text, f"{name} has no `{old}`")
        (self.dir / name).write_text(text.replace(old, new))


def readiness(process):
    """The status code of /readyz, and its text."""
    _, address = process.wait_for(
        lambda line: re.search(r" listening .*?(?:metrics|address)=(127\.0\.0\.1:\d+)$", line), 15,
        f"{process.name} listens")
    try:
        with urllib.request.urlopen(f"http://{address.group(1)}/readyz", timeout=10) as page:
            return page.status, page.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def wait_ready(process, code, seconds):
    deadline = time.monotonic() + seconds
    while readiness(process)[0] != code:
        check(time.monotonic() < deadline, f"/readyz is {readiness(process)}, not {code}")
        time.sleep(0.2)


def wait_mode(fleet, mode, seconds=20):
    deadline = time.monotonic() + seconds
    while fleet.mode()["mode"] != mode:
        check(time.monotonic() < deadline, f"the robot is in {fleet.mode()['mode']}, not {mode}")
        time.sleep(0.2)


def lower(fleet, to="DEFAULT"):
    return fleet.ripsctl("level", "lower", "r1", "--to", to, "--reason", "try", check=False)


def arm(fleet, store=None, state=None):
    fleet.robot = fleet.start_robot()
    fleet.server = store.start(fleet, fleet.start_server) if store else fleet.start_server()
    fleet.sensor = fleet.start_agent("sensor")
    begin = lambda: fleet.start_agent("actuator")  # noqa: E731
    fleet.actuator = state.start(fleet, begin) if state else begin()
    fleet.wait_level("DEFAULT", 40)


# ------------------------------------------------------------------------------------ scenarios


@may_lower(("operator alice", "COMPROMISED", "DEFAULT"))
def store_on_a_full_disk(fleet):
    """Raises reach the robot, lowerings are refused, the server is not ready; when there is room
    again all is recorded."""
    fleet.prepare()
    disk = Disk(fleet.dir, "store")
    arm(fleet, store=disk)
    disk.fill()
    fleet.sensor.child.send_signal(signal.SIGUSR1)
    wait_mode(fleet, "ALERT")
    # What a file of the store has room for already can still be written.
    deadline = time.monotonic() + 60
    while readiness(fleet.server)[0] != 503:
        check(time.monotonic() < deadline, "the store goes on writing to a full disk")
        for _ in range(20):
            fleet.sensor.child.send_signal(signal.SIGUSR1)
            time.sleep(0.02)
    check("store" in readiness(fleet.server)[1], f"{readiness(fleet.server)}")
    code, _, error = lower(fleet)
    check(code == 1 and "store" in error, f"a lowering that cannot be recorded: {code} {error}")
    fleet.sensor.child.send_signal(signal.SIGUSR2)
    wait_mode(fleet, "COMPROMISED")
    check(fleet.level()["decided_level"] == "COMPROMISED", f"{fleet.level()}")
    waiting = fleet.query("alert", "list", "r1")["unrecorded"]
    check(any(a["text"] == "the second signal has come" for a in waiting),
          f"an operator does not see what the store cannot take: {waiting}")

    disk.free()

    wait_ready(fleet.server, 200, 40)
    fleet.wait_level("COMPROMISED", 20)
    check([d["to"] for d in decided(fleet)][-2:] == ["ALERT", "COMPROMISED"],
          f"what was decided on a full disk is not recorded: {decided(fleet)}")
    check(lower(fleet)[0] == 0, "a lowering is still refused")
    fleet.wait_level("DEFAULT", 20)


def store_on_a_disk_that_becomes_read_only(fleet):
    """As when it is full; and the server that is started again on a sound disk, without what could
    not be recorded, adopts it from the robot."""
    fleet.prepare()
    disk = Disk(fleet.dir, "store")
    arm(fleet, store=disk)
    fleet.sensor.child.send_signal(signal.SIGUSR1)
    fleet.wait_level("ALERT", 20)
    disk.break_it()
    fleet.sensor.child.send_signal(signal.SIGUSR2)
    wait_mode(fleet, "COMPROMISED")
    wait_ready(fleet.server, 503, 40)
    code, _, error = lower(fleet)
    check(code == 1 and "store" in error, f"a lowering that cannot be recorded: {code} {error}")
    fleet.server.kill(signal.SIGKILL)

    fleet.server = disk.start(fleet, fleet.start_server)

    fleet.wait_level("COMPROMISED", 40)
    check(any("does not know" in a["text"] and a["severity"] == "critical"
              for a in fleet.alerts()), f"not told: {[a['text'] for a in fleet.alerts()]}")


@may_lower(("operator alice", "ALERT", "DEFAULT"))
def actuator_on_a_full_disk(fleet):
    """It raises, and lowers only when it can write down that it does."""
    fleet.prepare()
    disk = Disk(fleet.dir, "state")
    arm(fleet, state=disk)
    disk.fill()
    fleet.sensor.child.send_signal(signal.SIGUSR1)
    wait_mode(fleet, "ALERT")
    fleet.wait_level("ALERT", 20)
    lower(fleet)
    deadline = time.monotonic() + 6
    while time.monotonic() < deadline:
        check(fleet.mode()["mode"] == "ALERT", "lowered without a record")
        check(fleet.level()["stage"] != "verified" or fleet.level()["decided_level"] == "ALERT",
              f"{fleet.level()}")
        time.sleep(0.5)
    check(metrics(fleet.actuator)["rips_actuator_write_failures_total"] > 0, "not counted")

    disk.free()

    fleet.wait_level("DEFAULT", 60)


def actuator_on_a_disk_that_becomes_read_only(fleet):
    """It raises, and, started again on a sound disk without its record of that, does not lower."""
    fleet.prepare()
    disk = Disk(fleet.dir, "state")
    arm(fleet, state=disk)
    disk.break_it()
    fleet.sensor.child.send_signal(signal.SIGUSR1)
    wait_mode(fleet, "ALERT")
    fleet.wait_level("ALERT", 20)
    check(metrics(fleet.actuator)["rips_actuator_write_failures_total"] > 0, "not counted")
    fleet.sensor.child.send_signal(signal.SIGUSR2)
    fleet.wait_level("COMPROMISED", 20)
    fleet.actuator.kill(signal.SIGKILL)

    fleet.actuator = disk.start(fleet, lambda: fleet.start_agent("actuator"))

    fleet.wait_level("COMPROMISED", 30)
    wait_mode(fleet, "COMPROMISED")


def spool_without_room(fleet, trouble):
    """Arms a sensor whose spool is on a disk of its own, and has `trouble` there while the server
    is away. What the sensor could not keep is counted: sent = judged + lost."""
    if os.geteuid() != 0:
        raise Skipped("only root may mount file systems")
    disk = Disk(fleet.dir, "spool")
    begin = fleet.start_agent
    fleet.start_agent = lambda role: disk.start(fleet, lambda: begin(role))
    options = fleet.write_agent_configs
    def with_dir():
        fleet.sensor_options = f"outbox: {{memory: 1MiB, disk: 64MiB, dir: {disk.mount}/spool}}\n"
        options()
    fleet.write_agent_configs = with_dir
    arm_under_load(fleet)
    load = fleet.start_publisher("--rate", 2_000)
    load.wait_for(lambda line: '"publishing"' in line, 20, "the publisher is read")
    time.sleep(2)
    lost = metrics(fleet.server)["rips_observations_lost_total"]
    fleet.server.kill(signal.SIGKILL)
    trouble(disk)
    fleet.sensor.child.send_signal(signal.SIGUSR1)
    time.sleep(25)
    check(fleet.sensor.running, "the sensor has ended")
    page = metrics(fleet.sensor)
    check(page["rips_sensor_outbox_bytes"] + page["rips_sensor_backlog_bytes"] < 4 << 20,
          f"it takes more memory than it may: {page}")
    return disk, load, lost


def account(fleet, load, lost):
    fleet.server = fleet.start_server()
    sent = published(load)
    wait_all_is_judged(fleet, 90)
    judged = judged_messages(fleet)
    lost += metrics(fleet.server)["rips_observations_lost_total"]
    check(sum(judged.values()) + lost == sent, f"sent {sent}, judged {judged}, lost {lost:g}")
    texts = [alert["text"] for alert in fleet.alerts()]
    check(texts.count("told by a signal") == 1, f"the signal is told in {texts}")
    print(json.dumps({"sent": sent, "judged": judged and sum(judged.values()), "lost": lost}))
    check(lost > 0, "nothing was lost: the disk was no trouble")


def spool_on_a_full_disk(fleet):
    """Memory does; what it cannot hold is a counted loss, and control observations are not."""
    disk, load, lost = spool_without_room(fleet, Disk.fill)
    disk.free()
    account(fleet, load, lost)


def spool_on_a_disk_that_becomes_read_only(fleet):
    _, load, lost = spool_without_room(fleet, Disk.break_it)
    account(fleet, load, lost)


fleet_test.SCENARIOS = [store_on_a_full_disk, store_on_a_disk_that_becomes_read_only,
                        actuator_on_a_full_disk, actuator_on_a_disk_that_becomes_read_only,
                        spool_on_a_full_disk, spool_on_a_disk_that_becomes_read_only]

if __name__ == "__main__":
    sys.exit(fleet_test.main(
        lambda scenario: Fleet if scenario.__name__.startswith("spool") else OnDisks))
