"""Daemons and root helpers on platforms that misbehave. Their standard error is a full pipe that
nothing reads, or a file on a disk that hangs: they act as if it were read, and end at SIGTERM. Their
descriptors are closed, threads are few, the locale is another one.

    log_test.py BINARIES SCENARIO               runs one; without SCENARIO prints their names
    log_test.py BINARIES in_turn [TIMES [ROOM]]  starts each program in turn, without and with a full
        log pipe, and attacks the robot, TIMES times each (10). The full pipe had ROOM bytes left
        (0). Prints the time to a verified level, and from SIGTERM to the program's end
"""

import ctypes
import fcntl
import json
import os
import pathlib
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import disks_test  # noqa: E402
from fleet import (  # noqa: E402
    Failed, Fleet, Skipped, check, eventually, metrics, perform)

CLONE_NEWNET = 0x40000000
PROGRAMS = ["actuator", "sensor", "policy-server", "exec", "fw", "wire"]
ENDS_WITHIN = 2.0  # seconds after SIGTERM
COMMA = """comment_char %
escape_char /
LC_NUMERIC
decimal_point ","
thousands_sep "."
grouping 3;3
END LC_NUMERIC
"""
RULES = "chain input {\n  counter accept\n}\n"


class Pipe:
    """A pipe of one page that is never read, and has `room` bytes left."""

    def __init__(self, room=0):
        self.read_end, self.write_end = os.pipe()
        size = fcntl.fcntl(self.write_end, fcntl.F_SETPIPE_SZ, 4096)
        os.write(self.write_end, b"x" * (size - room))

    def close(self):
        for fd in (self.read_end, self.write_end):
            os.close(fd)


class Unheard:
    """A process whose standard error is `pipe`; as fleet.Process, but without lines."""

    def __init__(self, name, args, directory, env, errors):
        self.name, self.lines = name, []
        self.child = subprocess.Popen([str(arg) for arg in args], stdin=subprocess.DEVNULL,
                                      stdout=subprocess.DEVNULL, stderr=errors, env=env,
                                      cwd=directory, start_new_session=True)

    @property
    def running(self):
        return self.child.poll() is None

    def wait_for(self, found, seconds, what, start=0):
        raise Failed(f"{what}: nothing is heard of {self.name}")

    def kill(self, sig=signal.SIGTERM, seconds=10):
        if self.running:
            os.kill(self.child.pid, sig)
        try:
            return self.child.wait(seconds)
        except subprocess.TimeoutExpired:
            os.kill(self.child.pid, signal.SIGKILL)
            self.child.wait(seconds)
            raise Failed(f"{self.name} did not end within {seconds} s of signal {sig}") from None


class Host(Fleet):
    """A robot with all programs of RIPS, in a network namespace of its own. Those in `unheard`
    write to a full pipe."""

    def __init__(self, binaries, directory):
        super().__init__(binaries, directory, fail_safe="HALT", floor_hold="1s")
        if os.geteuid() != 0:
            raise Skipped("programs of an allow-list and packet filters need root")
        if ctypes.CDLL(None, use_errno=True).unshare(CLONE_NEWNET) != 0:
            raise Skipped("network namespaces are not allowed here")
        subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
        if subprocess.run(["nft", "list", "ruleset"], capture_output=True).returncode != 0:
            raise Skipped("the packet filter cannot be used here")
        # Every directory on the way must be root's alone, which /tmp is not.
        self.allowed = pathlib.Path(tempfile.mkdtemp(prefix="rips-test-", dir="/opt"))
        self.allowed.chmod(0o755)
        (self.allowed / "note").write_text("#!/bin/sh\necho noted\n")
        (self.allowed / "note").chmod(0o755)
        self.programs = f"programs:\n  - {{name: note, path: {self.allowed}/note}}\n"
        rules = self.write("rules.nft", RULES)
        run_note = "{program: {name: note}, timeout: 4s}"
        self.steps = {level: [run_note, "{firewall: {file: %s}}" % rules] for level in self.levels}
        self.steps["DEFAULT"] = ["{firewall: {release: all}}"]
        self.sensor_options = f"wire: {{enabled: true, socket: {self.dir}/wire.sock}}\n"
        self.state_dir = self.dir / "actuator"
        self.unheard = {}  # program -> its standard error, which is a descriptor
        self.alone = []  # what the command of each program begins with
        self.fw = self.wire = None

    def start(self, name, *args):
        if name in PROGRAMS:
            args = [*self.alone, *args]
        if name not in self.unheard:
            return super().start(name, *args)
        process = Unheard(name, [*self.within, *args, "--log-level", "debug"], self.dir, self.env,
                          self.unheard[name])
        self.processes.append(process)
        return process

    def write_agent_configs(self):
        super().write_agent_configs()
        path = self.dir / "actuator.yaml"
        text = path.read_text().replace(f"state_dir: {self.dir}/actuator\n",
                                        f"state_dir: {self.state_dir}\n")
        path.write_text(text + f'firewall: {{socket: {self.dir}/fw.sock, user: "0"}}\n')

    def start_helper(self, name, *args):
        ready = self.dir / f"{name}.ready"
        ready.unlink(missing_ok=True)
        process = self.start(name, self.path_of(f"rips-{name}"), *args, "--ready-file", ready)
        self._ready(process, ready, f"rips-{name}")
        return process

    def begin(self, name):
        """Starts that program, as the last one that was missing."""
        if name == "policy-server":
            self.server = self.start_server()
        elif name == "sensor":
            self.sensor = self.start_agent("sensor")
        elif name == "actuator":
            self.actuator = self.start_agent("actuator")
        elif name == "exec":
            self.start_exec()
        elif name == "fw":
            self.fw = self.start_helper("fw", "--config", self.dir / "actuator.yaml")
        else:
            self.wire = self.start_helper("wire", "--domain", self.domain, "--socket",
                                          self.dir / "wire.sock")
        return self.of(name)

    def of(self, name):
        return getattr(self, "server" if name == "policy-server" else name)

    def arm_all(self):
        self.prepare()
        self.robot = self.start_robot()
        self.begin("policy-server")
        self.write_agent_configs()
        for name in ("fw", "exec", "sensor", "actuator", "wire"):
            self.begin(name)
        self.wait_level("DEFAULT", 40)

    def end(self, name):
        """Seconds until SIGTERM has ended it."""
        began = time.monotonic()
        self.of(name).kill(signal.SIGTERM, seconds=20)
        return time.monotonic() - began

    def attack(self, seconds=20):
        """Seconds from the first message of a second driver until COMPROMISED is verified, by a
        watch of an operator; the driver goes on."""
        watch = self.start("watch", *self.ripsctl_args("--output", "json", "robot", "watch",
                                                       self.robot_id))
        watch.wait_for(lambda line: line.startswith("{"), 15, "the watch begins")
        self.driver = self.start_intruder("rogue-cmd-vel")
        at, _ = self.driver.wait_for(lambda line: '"first_sample"' in line, 15, "the driver drives")

        def verified(line):
            return '"COMPROMISED"' in line and '"verified"' in line and json.loads(line)

        seen, _ = watch.wait_for(verified, seconds, "COMPROMISED is verified")
        watch.kill()
        return watch.lines[seen][0] - self.driver.lines[at][0]

    def calm(self):
        """Back to DEFAULT after an attack."""
        text = "only /navigator publishes on /cmd_vel again"
        before = [alert["text"] for alert in self.alerts()].count(text)
        self.driver.kill()
        eventually(lambda: [alert["text"] for alert in self.alerts()].count(text) > before, 20,
                   "the driver has left")
        self.ripsctl("level", "lower", self.robot_id, "--to", "DEFAULT", "--reason", "over")
        self.wait_level("DEFAULT", 20)

    def stop(self):
        super().stop()
        shutil.rmtree(self.allowed, ignore_errors=True)


# ------------------------------------------------------------------------------------ scenarios


def answered(host, errors):
    """With such a standard error of all programs, they start, answer an attack, and end; without
    the server the actuator applies its fail-safe level."""
    host.unheard = {name: errors() for name in PROGRAMS}
    host.arm_all()
    took = host.attack()
    host.server.kill(signal.SIGKILL)
    eventually(lambda: host.mode()["mode"] == "HALT", 20, "the fail-safe level is applied")
    host.begin("policy-server")
    slow = {name: round(seconds, 2) for name in PROGRAMS
            if (seconds := host.end(name)) > ENDS_WITHIN}
    print(json.dumps({"verified_s": round(took, 3)}))
    check(not slow, f"SIGTERM ended them late: {slow}")


def pipes_are_full_at_the_start(host):
    answered(host, lambda: Pipe().write_end)


def pipes_become_full(host):
    answered(host, lambda: Pipe(room=700).write_end)


def descriptors_are_closed_at_the_start(host):
    """Nothing else gets the numbers 0 to 2, whatever is opened first."""
    host.alone = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh"]
    host.arm_all()
    for name in PROGRAMS:
        numbers = pathlib.Path(f"/proc/{host.of(name).child.pid}/fd")
        opened = [os.readlink(numbers / str(fd)) for fd in range(3)]
        check(opened[:2] == ["/dev/null"] * 2 and opened[2].startswith("pipe:"),
              f"the descriptors of {name} are {opened}")


def the_disk_hangs(host):
    """That of the actuator's state and of the logs of all: as answered(). What a frozen file system
    holds in the kernel is gone when it is thawed."""
    disk = disks_test.Disk(host.dir, "frozen")
    subprocess.run(["mount", "-o", "loop", disk.image, disk.mount], check=True)
    try:
        logs = {name: os.open(disk.mount / name, os.O_WRONLY | os.O_CREAT, 0o600)
                for name in PROGRAMS}
        host.state_dir = disk.mount / "state"
        host.unheard = logs
        host.arm_all()
        subprocess.run(["fsfreeze", "--freeze", disk.mount], check=True)
        try:
            took = host.attack()
            host.server.child.send_signal(signal.SIGKILL)
            eventually(lambda: host.mode()["mode"] == "HALT", 20, "the fail-safe level is applied")
        finally:
            subprocess.run(["fsfreeze", "--unfreeze", disk.mount], check=True)
        print(json.dumps({"verified_s": round(took, 3)}))
        host.server.child.wait(20)
        for name in PROGRAMS[:2]:
            host.end(name)
    finally:
        host.stop()
        for fd in logs.values():
            os.close(fd)
        subprocess.run(["umount", disk.mount], check=False)


def few_threads(host):
    """A daemon that cannot start a thread says which limit it is, and ends; it does not hang."""
    user = 64_123  # has no other process
    host.prepare()
    host.write("sensor/x", "")
    host.port = 1  # refuses
    host.write_agent_configs()
    subprocess.run(["chown", "-R", f"{user}:{user}", host.dir], check=True)
    ended = {}
    for limit in (3, 8, 16):
        for name in ("policy-server", "sensor", "actuator", "exec"):
            config = "actuator" if name == "exec" else name
            process = host.start(
                name, "prlimit", f"--nproc={limit}:{limit}", "setpriv", f"--reuid={user}",
                f"--regid={user}", "--clear-groups", host.path_of(f"rips-{name}"), "--config",
                host.dir / f"{config}.yaml", "--ready-file", host.dir / f"{name}.{limit}")
            ready = host.dir / f"{name}.{limit}"
            deadline = time.monotonic() + 10
            while process.running and not ready.exists():
                check(time.monotonic() < deadline, f"{name} hangs with {limit} threads")
                time.sleep(0.02)
            if process.running:
                process.kill(seconds=ENDS_WITHIN)
                ended[f"{name} {limit}"] = "ready"
            else:
                process.kill()
                text = "\n".join(text for _, text in process.lines)
                check("limit of processes" in text or "thread" in text,
                      f"{name} with {limit} threads ended without a reason: {text}")
                ended[f"{name} {limit}"] = process.child.returncode
    print(json.dumps(ended))
    check("ready" not in [ended[f"{name} 3"] for name in ("policy-server", "sensor")],
          f"the limit limits nothing: {ended}")


def another_locale(host):
    """A decimal comma of the environment changes no number of ours."""
    locales = host.dir / "locales"
    locales.mkdir()
    subprocess.run(["localedef", "-c", "-i", host.write("comma.src", COMMA), "-f",
                    "ANSI_X3.4-1968", locales / "comma"], capture_output=True)
    if not (locales / "comma/LC_NUMERIC").exists():
        raise Skipped("no locale can be made here")
    host.env.update(LOCPATH=str(locales), LC_NUMERIC="comma")
    shown = subprocess.run(["/usr/bin/printf", "%.1f", "1,5"], capture_output=True, text=True,
                           env=host.env)
    check(shown.stdout == "1,5", f"the locale has no decimal comma: {shown}")
    host.prepare()
    host.begin("policy-server")
    host.begin("sensor")
    page = metrics(host.server) | metrics(host.sensor)  # float() of each value
    check(any(value % 1 for value in page.values()), "no metric has decimals")
    host.query("robot", "list")
    shown = subprocess.run([host.path_of("rips-sensor"), "--check-config", "--config",
                            host.dir / "sensor.yaml"], capture_output=True, text=True, env=host.env)
    host.env.update(LC_NUMERIC="C")
    plain = subprocess.run([host.path_of("rips-sensor"), "--check-config", "--config",
                            host.dir / "sensor.yaml"], capture_output=True, text=True, env=host.env)
    check(shown.returncode == 0 and shown.stdout == plain.stdout,
          f"--check-config differs: {shown.stdout} {plain.stdout}")


SCENARIOS = [pipes_are_full_at_the_start, pipes_become_full, descriptors_are_closed_at_the_start,
             the_disk_hangs, few_threads, another_locale]


def in_turn(host, times, room):
    """The figures of the head of this file."""
    host.arm_all()
    print(f"{'':14} {'verified, s: not full':>22} {'full':>13} {'ratio':>6} {'SIGTERM, s':>11}")
    print(f"{'program':14} {'median':>14} {'max':>7} {'median':>7} {'max':>5}", flush=True)
    for name in PROGRAMS:
        took, ended = {False: [], True: []}, []
        for _ in range(times):
            for full in (False, True):
                host.of(name).kill()
                pipe = Pipe(room)
                if full:
                    host.unheard = {name: pipe.write_end}
                host.begin(name)
                host.wait_level("DEFAULT", 40)
                took[full].append(host.attack())
                host.calm()
                if full:
                    ended.append(host.end(name))
                    host.unheard = {}
                    host.begin(name)
                    host.wait_level("DEFAULT", 40)
                pipe.close()
        without, with_full = (statistics.median(took[full]) for full in (False, True))
        print(f"{name:14} {without:14.3f} {max(took[False]):7.3f} {with_full:7.3f} "
              f"{max(took[True]):5.3f} {with_full / without:6.2f} {max(ended):11.2f}", flush=True)


def main():
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    binaries, name, *more = sys.argv[1:]
    if name == "in_turn":
        times, room = int(more[0]) if more else 10, int(more[1]) if len(more) > 1 else 0
        scenario = lambda host: in_turn(host, times, room)  # noqa: E731
    else:
        scenario = next(each for each in SCENARIOS if each.__name__ == name)
    parent = pathlib.Path(binaries).resolve().parent / "scenarios"
    parent.mkdir(exist_ok=True)
    directory = pathlib.Path(tempfile.mkdtemp(prefix=f"log_{name}.", dir=parent))
    directory.chmod(0o755)
    try:
        host = Host(binaries, directory)
    except Skipped as skipped:
        print(f"skipped {name}: {skipped}")
        return 77
    code = perform(name, scenario, host)
    if code != 1:
        shutil.rmtree(directory)
    return code


if __name__ == "__main__":
    sys.exit(main())
