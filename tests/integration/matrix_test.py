"""Whatever fails while a level is ordered, the robot ends at that level or above, or at the fail-safe
level, and the server knows which.

    matrix_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
    matrix_test.py BINARIES --table       prints what the last run of each found

Each scenario is a few faults. For each fault, every pair of levels: the fault sets in, an operator
orders the second level, and when all is settled the robot itself, its alarm, its packet filter and
what the server says are compared. Then the fault ends, and all must come right by itself. The table
that is printed has a line for each fault and a column for each pair.
"""

import os
import pathlib
import random
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import termios
import threading
import time
import tty

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import LEVELS, MODES, Failed, Fleet, Skipped, check, log_time, perform  # noqa: E402
from network import need_namespaces  # noqa: E402

# Each ordered pair of levels once, as one walk from DEFAULT back to DEFAULT.
STOPS = "DEFAULT ALERT DEFAULT COMPROMISED DEFAULT HALT ALERT COMPROMISED ALERT HALT COMPROMISED HALT"
WALK = list(zip(STOPS.split(), STOPS.split()[1:] + ["DEFAULT"]))
# Sanitizers slow the whole fleet down: a raise and a lowering.
SANITIZED = bool(os.environ.get("RIPS_SANITIZE"))
if SANITIZED:
    WALK = [("DEFAULT", "COMPROMISED"), ("COMPROMISED", "DEFAULT")]
WIDTH = 52
HEADER = " " * WIDTH + "".join(f"{a[0]}>{b[0]}".center(4) for a, b in WALK)
LIMIT = 90 if SANITIZED else 45  # seconds anything here may take on a busy machine
FAIL_SAFE = "COMPROMISED"
LEASE = "5s" if SANITIZED else "2s"
FAKETIME = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1"


# Of the robot's System Modes file.
INACTIVE = {"DEFAULT": set(), "ALERT": {"/camera"},
            "COMPROMISED": {"/camera", "/base", "/navigator"},
            "HALT": {"/camera", "/lidar", "/base", "/navigator"}}


def rank(level):
    return LEVELS.index(level)


def wait_for(what, found, seconds=None):
    """The first true value of found()."""
    deadline = time.monotonic() + (seconds or LIMIT)
    while True:
        value = found()
        if value:
            return value
        if time.monotonic() > deadline:
            raise Failed(f"{what}: not within {seconds or LIMIT} s")
        time.sleep(0.05)


class Siren:
    """An LCUS board with one relay on a pseudo terminal; `link` is what udev would keep."""

    def __init__(self, link):
        self.link = link
        self.on = False
        self.silent = False
        self.unplug_in_write = False
        self._master = None
        self._lock = threading.Lock()
        self.plug()

    @property
    def plugged(self):
        return self._master is not None

    def plug(self):
        master, slave = os.openpty()
        tty.setraw(slave, termios.TCSANOW)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(slave))
        with self._lock:
            self._master, self._slave = master, slave
        threading.Thread(target=self._serve, args=(master,), daemon=True).start()

    def unplug(self):
        with self._lock:
            if self._master is None:
                return
            master, self._master = self._master, None
            self.link.unlink(missing_ok=True)
            os.close(self._slave)
            os.close(master)

    def _serve(self, master):
        frame = b""
        while True:
            try:
                if not select.select([master], [], [], 0.1)[0]:
                    with self._lock:
                        if self._master != master:
                            return
                    continue
                frame += os.read(master, 1)
            except (OSError, ValueError):
                return
            if frame != b"\xff" and self.unplug_in_write:
                self.unplug()
                return
            if frame == b"\xff":
                if not self.silent:
                    os.write(master, b"CH1: ON \r\n" if self.on else b"CH1:OFF\r\n")
                frame = b""
            elif len(frame) == 4:
                self.on = frame[2] == 1
                frame = b""


class Rig(Fleet):
    """A fleet whose levels have a mode, a siren, rules of the packet filter and a program."""

    def __init__(self, binaries, directory):
        super().__init__(binaries, directory, bundle="plain", fail_safe=FAIL_SAFE, floor_hold="1s")
        self.namespace = f"ripsmx{random.getrandbits(32):08x}"
        # Every directory on the way must be root's alone, which /tmp is not.
        self.programs = pathlib.Path(tempfile.mkdtemp(prefix="rips-test-", dir="/opt"))
        self.siren = Siren(self.dir / "siren")
        self.fw = None
        self.actuator_env = {}
        self.robot_options = []
        self.state_dir = self.dir / "actuator"
        self.program("note", "exit 0")

    # ------------------------------------------------------------------------------- set-up

    def program(self, name, text):
        """Puts a shell script in the place of a program at once."""
        path = self.programs / f".{name}"
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)
        path.rename(self.programs / name)

    def write_server_config(self, port):
        self.write("bundles/plain/manifest.yaml",
                   f"name: plain\nrules: [p.rul]\nlevels: [{', '.join(LEVELS)}]\n")
        self.write("bundles/plain/p.rul", "levels:\n" + "".join(f"  {x};\n" for x in LEVELS) +
                   "rules External:\n" + "".join(f"  {x.lower()}: false ? trigger({x});\n"
                                                 for x in LEVELS))
        super().write_server_config(port)
        path = self.dir / "policy-server.yaml"
        path.write_text(path.read_text() + f"timing: {{lease: {LEASE}, lost: 1900ms}}\n")

    def write_agent_configs(self):
        super().write_agent_configs()
        path = self.dir / "actuator.yaml"
        text = re.sub("^exec: .*\n", "", path.read_text().partition("levels:\n")[0], flags=re.M)
        text = text.replace("floor_hold: ", "reconcile: 500ms, floor_hold: ")
        rules = self.write("rules.nft", "chain input {\n  udp dport 9 counter drop\n}\n")
        steps = {"DEFAULT": "{firewall: {release: all}}"}
        for level in LEVELS:
            mode = MODES.get(level, level)
            siren = "off" if level == "DEFAULT" else "on"
            fw = steps.get(level, f"{{firewall: {{file: {rules}}}}}")
            text += "" if "levels:" in text else "levels:\n"
            text += f"""  - name: {level}
    enter:
      - {{system_mode: {{part: /safety, mode: {mode}}}, timeout: 1500ms, retries: 1}}
      - {fw}
      - {{program: {{name: note}}, timeout: 1s}}
      - {{alarm: {{device: siren, state: "{siren}"}}, timeout: 1s}}
"""
        text += f"""programs:
  - {{name: note, path: {self.programs}/note, timeout: 1s}}
exec: {{socket: {self.dir}/exec.sock, user: root}}
devices:
  - {{name: siren, kind: lcus_serial, path: {self.siren.link}}}
firewall: {{socket: {self.dir}/fw.sock, user: root}}
"""
        path.write_text(text)

    def start_fw(self):
        self.fw = self.start("fw", "ip", "netns", "exec", self.namespace, "unshare", "--mount",
                             self.bin / "rips-fw", "--config", self.dir / "actuator.yaml")
        self.fw.wait_for(lambda line: " listening" in line, LIMIT, "rips-fw listens")

    def start_actuator(self):
        env, self.env = self.env, dict(self.env, **self.actuator_env)
        self.actuator = self.start_agent("actuator")
        self.env = env

    def build(self):
        need_namespaces()
        subprocess.run(["ip", "netns", "add", self.namespace], check=True)
        subprocess.run(["ip", "-n", self.namespace, "link", "set", "lo", "up"], check=True)
        self.prepare()
        self.robot = self.start_robot("--control", self.dir / "robot.control", *self.robot_options)
        self.server = self.start_server()
        self.write_agent_configs()
        self.start_fw()
        self.start_exec()
        self.sensor = self.start_agent("sensor")
        self.start_actuator()
        self.wait_level("DEFAULT", LIMIT)

    def stop(self):
        super().stop()
        if pathlib.Path("/run/netns", self.namespace).exists():
            subprocess.run(["ip", "netns", "delete", self.namespace], check=False)
        shutil.rmtree(self.programs, ignore_errors=True)

    def tell_robot(self, line):
        start = len(self.robot.lines)
        with open(self.dir / "robot.control", "w", encoding="ascii") as pipe:
            pipe.write(line + "\n")
        self.robot.wait_for(lambda text: f'"line":"{line}"' in text, LIMIT, line, start)

    def nft(self, *args):
        done = subprocess.run(["ip", "netns", "exec", self.namespace, "nft", *args],
                              capture_output=True, text=True, timeout=LIMIT)
        return done.returncode, done.stdout

    # ------------------------------------------------------------------------- what is true

    def order_args(self, level, at=None):
        """The command that brings the robot from level `at`, by default the decided one, to
        `level`."""
        down = rank(level) < rank(at or self.level()["decided_level"])
        return self.ripsctl_args("level", "lower" if down else "raise", "r1", "--to", level,
                                 "--reason", "matrix", *(["--accept-blind"] if down else []))

    def order(self, level):
        done = self.run_ripsctl(self.order_args(level), LIMIT)
        check(done.returncode == 0, f"{level} was not ordered: {done.stderr.strip()}")

    def robot_mode(self):
        """The level whose mode the nodes are in by themselves; "" if in none."""
        mode = ""
        for event in self.robot.events():
            if event["event"] in ("ready", "mode"):
                mode = event["mode"]
        return {value: key for key, value in MODES.items()}.get(mode, mode)

    def truth(self):
        """What the robot, its siren and its packet filter do."""
        code, table = self.nft("list", "table", "inet", "rips")
        return {"mode": self.robot_mode(), "siren": self.siren.on and self.siren.plugged,
                "rules": code == 0 and "udp dport 9 " in table}

    def last_level(self):
        """The actuator's newest line on its level, as a dictionary."""
        for _, text in reversed(self.actuator.lines):
            if " level decided=" in text:
                return dict(re.findall(r"(\w+)=(\"[^\"]*\"|\S*)", text))
        return {}

    def settled(self):
        """The status once the newest decision was reached or has failed."""
        def found():
            status = self.level()
            return status if status["stage"] in ("verified", "failed") else None
        return wait_for("the order is carried out or fails", found)

    def at_peace(self, level):
        """Waits until `level` holds, verified, and nothing is wrong."""
        self.wait_level(level, LIMIT)
        wait_for(f"all of {level} is as it must be", lambda: not self.wrong(level, self.truth()))

    @staticmethod
    def wrong(level, truth):
        """What is not as `level` asks for; empty if all is."""
        wanted = {"mode": level, "siren": level != "DEFAULT", "rules": level != "DEFAULT"}
        return {key: truth[key] for key in wanted if truth[key] != wanted[key]}


# ---------------------------------------------------------------------------------- faults


class Fault:
    """`begin` before the order, `end` after it was judged. The class's docstring is its name."""

    def __init__(self, rig):
        self.rig = rig

    def begin(self):
        pass

    def order(self, level):
        self.rig.order(level)

    def end(self):
        pass

    def judge(self, ordered):
        """What became of the order; see LEGEND."""
        status = self.rig.settled()
        return verdict(self.rig, status, ordered)

    def judge_in_the_end(self, ordered):
        """The first verdict that is none of a failure."""
        deadline = time.monotonic() + LIMIT
        while True:
            try:
                return Fault.judge(self, ordered)
            except Failed:
                if time.monotonic() > deadline:
                    raise
            time.sleep(0.3)


LEGEND = """    =  reached and verified: so it is with robot, siren and packet filter
    +  the robot is above the level decided, and the server says what failed
    !  the robot's mode is the level's, a further step failed, and the server says which
    F  at the fail-safe level or above while nobody commands, then as decided
    x  the other order came last, and holds
    n  a node obeys nobody, and the server names it; all others are as ordered
"""


def verdict(rig, status, ordered):
    decided = status["decided_level"]
    truth = rig.truth()
    seen = f"{truth}; the server says {status}"
    check(truth["mode"], f"the nodes are in no mode: {seen}")
    check(rank(truth["mode"]) >= rank(decided), f"below the level decided: {seen}")
    if status["stage"] == "verified":
        check(status["effective_level"] == truth["mode"], f"the server is wrong: {seen}")
        wait_for(f"what is verified is true: {seen}",
                 lambda: not rig.wrong(status["effective_level"], rig.truth()), 5)
        return "=" if decided == ordered else "x"
    check(any("level not reached" in text for text in status["degraded"]),
          f"the server does not say why: {seen}")
    return "!" if truth["mode"] == decided else "+"


class Silent(Fault):
    """the siren does not answer"""

    def begin(self):
        self.rig.siren.silent = True

    def end(self):
        self.rig.siren.silent = False


class Unplugged(Fault):
    """the siren is unplugged"""

    def begin(self):
        self.rig.siren.unplug()

    def end(self):
        self.rig.siren.plug()


class UnpluggedInWrite(Fault):
    """the siren is unplugged while it is told"""

    def begin(self):
        self.rig.siren.unplug_in_write = True

    def end(self):
        self.rig.siren.unplug_in_write = False
        self.rig.siren.plug()


class DeadLine(Fault):
    """the siren's line is dead (EIO)"""

    def begin(self):
        link = self.rig.siren.link
        self.rig.siren.unplug()
        dead, other = os.openpty()
        link.symlink_to(os.ttyname(other))
        self.other = other
        os.close(dead)  # what is open answers EIO from now on

    def end(self):
        os.close(self.other)
        self.rig.siren.plug()


class Program(Fault):
    text = "exit 0"

    def begin(self):
        self.rig.program("note", self.text)

    def end(self):
        self.rig.program("note", "exit 0")


class ProgramFails(Program):
    """the program fails"""
    text = "echo out of paint; exit 3"


class ProgramHangs(Program):
    """the program ignores SIGTERM"""
    text = "trap '' TERM\nsleep 60 & wait; sleep 60"


class ProgramForks(Program):
    """the program leaves a daemon behind"""

    def begin(self):
        self.pids = self.rig.dir / "daemons"
        self.text = f"setsid sh -c 'echo $$ >> {self.pids}; exec sleep 600' & sleep 0.2"
        super().begin()

    def judge(self, ordered):
        outcome = super().judge(ordered)
        wait_for("what it left is killed", lambda: not any(
            pathlib.Path("/proc", pid).exists() for pid in self.pids.read_text().split()))
        return outcome


class ProgramFloods(Program):
    """the program writes a gigabyte"""
    text = "exec head -c 1000000000 /dev/zero"


class ExecKilled(Fault):
    """rips-exec is killed"""

    def begin(self):
        self.rig.exec.kill(signal.SIGKILL)

    def end(self):
        self.rig.start_exec()


class ExecKilledInRun(Fault):
    """rips-exec is killed while the program runs"""

    def order(self, level):
        began = self.rig.dir / "began"
        began.unlink(missing_ok=True)
        self.rig.program("note", f"touch {began}; sleep 0.5")
        super().order(level)
        wait_for("the program runs", began.exists)
        self.rig.exec.kill(signal.SIGKILL)
        self.rig.program("note", "exit 0")

    def end(self):
        self.rig.start_exec()


class ExecHangs(Fault):
    """rips-exec hangs"""

    def begin(self):
        os.kill(self.rig.exec.child.pid, signal.SIGSTOP)

    def end(self):
        os.kill(self.rig.exec.child.pid, signal.SIGCONT)


class ProgramGone(Fault):
    """the program is gone"""

    def begin(self):
        (self.rig.programs / "note").unlink()

    def end(self):
        self.rig.program("note", "exit 0")


class ProgramUnsafe(Fault):
    """anybody may write the program"""

    def begin(self):
        (self.rig.programs / "note").chmod(0o777)

    def end(self):
        self.rig.program("note", "exit 0")


class FwKilled(Fault):
    """rips-fw is killed"""

    def begin(self):
        self.rig.fw.kill(signal.SIGKILL)

    def end(self):
        self.rig.start_fw()


class FwHangs(Fault):
    """rips-fw hangs"""

    def begin(self):
        os.kill(self.rig.fw.child.pid, signal.SIGSTOP)

    def end(self):
        os.kill(self.rig.fw.child.pid, signal.SIGCONT)


class NftMissing(Fault):
    """nft is missing"""

    def _mounts(self, *command):
        subprocess.run(["nsenter", "--target", str(self.rig.fw.child.pid), "--mount", *command],
                       check=True)

    def begin(self):
        self._mounts("mount", "--bind", "/dev/null", "/usr/sbin/nft")

    def end(self):
        self._mounts("umount", "/usr/sbin/nft")


class TableDeleted(Fault):
    """somebody deletes the table"""

    def order(self, level):
        super().order(level)
        self.rig.nft("delete", "table", "inet", "rips")


class Manager(Fault):
    """`begins` and `ends` are orders to the simulated robot (robot_sim/control.h)."""
    begins = ends = ()

    def begin(self):
        for line in self.begins:
            self.rig.tell_robot(line)

    def end(self):
        for line in self.ends:
            self.rig.tell_robot(line)

class ManagerLies(Manager):
    """the manager lies: `success`, and nothing"""
    begins, ends = ["conduct lie"], ["conduct honest"]


class ManagerDeceives(Manager):
    """the manager says that it is done, and is not"""
    begins, ends = ["conduct deceive"], ["conduct honest"]


class ManagerRefuses(Manager):
    """the manager refuses"""
    begins, ends = ["conduct refuse"], ["conduct honest"]


class ManagerAbsent(Manager):
    """there is no manager"""
    begins, ends = ["manager stop"], ["manager start"]


class ManagerRestarts(Manager):
    """the manager restarts in the middle"""

    def order(self, level):
        super().order(level)
        for line in ("manager stop", "manager start"):
            self.rig.tell_robot(line)


class ManagerForgets(Manager):
    """the manager knows no modes of the parts"""
    begins = ["modes forget"]


class ManagerChangesFile(Manager):
    """the manager's file lacks the mode"""
    ends = ["mode restore"]

    def order(self, level):
        self.rig.tell_robot(f"mode remove {MODES.get(level, level)}")
        super().order(level)


class ManagerPullsBack(Manager):
    """the manager's rules pull the mode back"""
    ends = ["conduct honest"]

    def order(self, level):
        before = self.rig.level()["decided_level"]
        self.rig.tell_robot(f"pull {MODES.get(level, level)} {MODES.get(before, before)}")
        super().order(level)

    def judge(self, ordered):
        """For as long as it pulls, the mode is put back; in the end it stays."""
        time.sleep(3)
        return self.judge_in_the_end(ordered)


class Attacked(Manager):
    """somebody else orders the mode of before"""

    def order(self, level):
        rig = self.rig
        before = rig.level()["decided_level"]
        super().order(level)
        subprocess.run([rig.bin / "robot_sim", "set-mode", "--domain", str(rig.domain), "--part",
                        "/safety", "--mode", MODES.get(before, before)], check=True, env=rig.env,
                       stdout=subprocess.DEVNULL, timeout=LIMIT)

    def judge(self, ordered):
        """The stranger is obeyed for as long as it takes to see it."""
        time.sleep(0.5)
        return self.judge_in_the_end(ordered)


class NodeStuck(Manager):
    """a node does not do as it is told"""
    begins, ends = ["stuck /camera on"], ["stuck /camera off"]

    def judge(self, ordered):
        """Nobody can move it: what is asked is that people hear of it."""
        status = self.rig.settled()
        if status["stage"] == "verified":
            return verdict(self.rig, status, ordered)
        check(any("/camera" in text for text in status["degraded"]),
              f"the server does not name the node: {status}")
        states = {each["part"]: each["state"] for each in self.rig.mode()["parts"]}
        others = {part for part in states if part != "/camera" and states[part] == "inactive"}
        check(others == INACTIVE[ordered] - {"/camera"}, f"{states}, although only /camera is stuck")
        return "n"


class Twice(Fault):
    """ordered twice at once"""

    def order(self, level):
        children = []
        for args in (self.rig.order_args(level), self.second(level)):
            children.append(subprocess.Popen(args, stdin=subprocess.DEVNULL, env=self.rig.env,
                                             stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
            time.sleep(0.01)
        for child in children:
            child.wait(LIMIT)

    def second(self, level):
        return self.rig.order_args(level)


class ThereAndBack(Twice):
    """the opposite 10 ms later"""

    def second(self, level):
        return self.rig.order_args(self.rig.level()["decided_level"], at=level)

    def judge(self, ordered):
        """An order that was overtaken can reach the robot late: the next look puts it back."""
        return self.judge_in_the_end(ordered)


class Outage(Fault):
    """The policy server is killed; LEVEL is what the actuator's log says by then."""
    when = ""

    def order(self, level):
        rig = self.rig
        start = len(rig.actuator.lines)
        rig.program("note", "sleep 0.3")
        asking = subprocess.Popen(rig.order_args(level), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL, env=rig.env)
        if self.when:
            rig.actuator.wait_for(lambda line: self.when in line, LIMIT, "the order arrives", start)
        else:
            time.sleep(random.random() * 0.2)
        rig.server.kill(signal.SIGKILL)
        asking.wait(LIMIT)

    def judge(self, ordered):
        rig = self.rig
        safe = wait_for("the fail-safe level holds", self._held_alone)
        truth = rig.truth()
        check(truth["mode"] and rank(truth["mode"]) >= rank(FAIL_SAFE),
              f"below the fail-safe level: {truth}, {safe}")
        rig.server = rig.start_server()
        wait_for("the actuator is back", lambda: rig.level()["effective_level"])
        status = rig.level()
        check(rank(rig.robot_mode()) >= rank(status["decided_level"]),
              f"below the level decided: {rig.truth()}; the server says {status}")
        return "F"

    def _held_alone(self):
        level = self.rig.last_level()
        return level if (level.get("verified") == "true" and
                         rank(level["effective"]) >= rank(FAIL_SAFE)) else None

    def end(self):
        self.rig.program("note", "exit 0")


class OutageBefore(Outage):
    """the server dies as the order is given"""


class OutageDuring(Outage):
    """the server dies while the level is applied"""
    when = " applying level "


class OutageAfter(Outage):
    """the server dies after the receipt"""
    when = "stage=verified"


class ActuatorKilled(Fault):
    """the actuator is killed while it applies"""

    def order(self, level):
        start = len(self.rig.actuator.lines)
        self.rig.order(level)
        self.rig.actuator.wait_for(lambda line: " applying level " in line, LIMIT, "it applies",
                                   start)
        self.rig.actuator.kill(signal.SIGKILL)
        self.rig.start_actuator()


class StateLost(Fault):
    """the actuator's state is deleted"""

    def spoil(self, path):
        path.unlink()

    def order(self, level):
        rig = self.rig
        self.before = rig.robot_mode()
        rig.actuator.kill(signal.SIGKILL)
        self.spoil(rig.state_dir / "state")
        rig.order(level)
        rig.start_actuator()

    def judge(self, ordered):
        """At its start it is at the fail-safe level or above, and the robot is not lowered."""
        wait_for("the actuator tells its level", self.rig.last_level)
        for _, text in self.rig.actuator.lines:
            if " level decided=" in text:
                first = dict(re.findall(r"(\w+)=(\"[^\"]*\"|\S*)", text))
                break
        check(rank(first["effective"]) >= rank(FAIL_SAFE), f"it starts at {first}")
        applied = wait_for("the actuator applies a level", lambda: [
            text for _, text in self.rig.actuator.lines if " applying level " in text])[0]
        first = dict(re.findall(r"(\w+)=(\"[^\"]*\"|\S*)", applied))["to"]
        check(rank(first) >= rank(self.before), f"from {self.before} it applies {first} first")
        def at_what_was_decided():
            # Read together: what the robot still holds may be adopted as a newer decision.
            status = self.rig.level()
            return (status["stage"] == "verified"
                    and status["decided_level"] == status["effective_level"])
        wait_for("the robot is at the level that was decided last", at_what_was_decided)
        return super().judge(ordered)


class StateTorn(StateLost):
    """the actuator's state is torn"""

    def spoil(self, path):
        path.write_bytes(path.read_bytes()[:-7])


class DiskFull(Fault):
    """the actuator's disk is full"""

    def begin(self):
        self.ballast = self.rig.state_dir / "ballast"
        with open(self.ballast, "wb", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(4096))
            except OSError:
                pass

    def end(self):
        self.ballast.unlink()


class ClockJumps(Fault):
    """the wall clock jumps by an hour"""
    ahead = False

    def order(self, level):
        super().order(level)
        ClockJumps.ahead = not ClockJumps.ahead
        clock = self.rig.dir / "clock"
        clock.with_suffix(".new").write_text("+3600\n" if ClockJumps.ahead else "+0\n")
        clock.with_suffix(".new").rename(clock)

    def judge(self, ordered):
        def jumped():
            told = log_time(self.rig.actuator.lines[-1][1])
            return told and (told / 1e9 - time.time() > 3000) == ClockJumps.ahead
        outcome = super().judge(ordered)
        wait_for("the actuator's clock jumps", jumped)
        return outcome


# ------------------------------------------------------------------------------- scenarios


def play(rig, faults):
    print(LEGEND + "\n" + HEADER, flush=True)
    rows = []
    for kind in faults:
        rows.append(kind.__doc__.ljust(WIDTH))
        print(rows[-1], end="", flush=True)
        for before, level in WALK:
            fault = kind(rig)
            fault.begin()
            fault.order(level)
            try:
                outcome = fault.judge(level)
            except Failed as failed:
                raise Failed(f"{kind.__doc__}, {before} to {level}: {failed}") from None
            finally:
                fault.end()
            if rig.level()["decided_level"] != level:
                rig.order(level)
            try:
                rig.at_peace(level)
            except Failed as failed:
                raise Failed(f"after {kind.__doc__}, {before} to {level}: {failed}") from None
            rows[-1] += outcome.center(4)
            print(outcome.center(4), end="", flush=True)
        print(flush=True)
    rig.table.parent.mkdir(exist_ok=True)
    rig.table.write_text("\n".join(rows) + "\n")


def print_table(tables):
    """False if there is none."""
    parts = [tables / f"{scenario.__name__}.txt" for scenario in SCENARIOS]
    parts = [part.read_text() for part in parts if part.exists()]
    if parts:
        print(LEGEND + "\n" + HEADER + "\n" + "".join(parts), end="")
    return bool(parts)


def managers(rig):
    rig.build()
    play(rig, [ManagerLies, ManagerDeceives, ManagerRefuses, ManagerAbsent])


def restarting_managers(rig):
    rig.build()
    play(rig, [ManagerRestarts, ManagerForgets, ManagerChangesFile])


def slow_manager(rig):
    class ManagerSlow(Fault):
        """the manager takes 900 ms to answer"""

    rig.robot_options = ["--answer-ms", "900"]
    rig.build()
    play(rig, [ManagerSlow])


def strangers(rig):
    rig.build()
    play(rig, [ManagerPullsBack, Attacked, NodeStuck])


def alarms(rig):
    rig.build()
    play(rig, [Silent, Unplugged, UnpluggedInWrite, DeadLine])


def programs(rig):
    rig.build()
    play(rig, [ProgramFails, ProgramHangs, ProgramFloods, ProgramGone, ProgramUnsafe])


def daemons(rig):
    rig.build()
    if any("cgroups=none" in text for _, text in rig.exec.lines):
        raise Skipped("no cgroup v2 can be made here, and only there a daemon ends with its run")
    play(rig, [ProgramForks])


def runner(rig):
    rig.build()
    play(rig, [ExecKilled, ExecKilledInRun, ExecHangs])


def firewall(rig):
    rig.build()
    play(rig, [FwKilled, FwHangs, NftMissing, TableDeleted])


def orders(rig):
    rig.build()
    play(rig, [Twice, ThereAndBack])


def outage(rig):
    rig.floor_hold = "0ms"  # it doubles each time
    rig.build()
    play(rig, [OutageBefore, OutageDuring, OutageAfter])


def restarts(rig):
    rig.floor_hold = "0ms"
    rig.build()
    play(rig, [ActuatorKilled, StateLost, StateTorn])


def clock(rig):
    if SANITIZED:
        raise Skipped("libfaketime and sanitizers cannot be in one process")
    (rig.dir / "clock").write_text("+0\n")
    rig.actuator_env = {"LD_PRELOAD": FAKETIME, "FAKETIME_TIMESTAMP_FILE": f"{rig.dir}/clock",
                        "FAKETIME_NO_CACHE": "1", "FAKETIME_DONT_FAKE_MONOTONIC": "1"}
    rig.build()
    play(rig, [ClockJumps])


def disk(rig):
    rig.state_dir.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "rips-matrix", rig.state_dir],
                          capture_output=True, text=True)
    if done.returncode != 0:
        raise Skipped(f"no tmpfs can be mounted: {done.stderr.strip()}")
    try:
        rig.build()
        play(rig, [DiskFull])
    finally:
        rig.stop()
        subprocess.run(["umount", rig.state_dir], check=True)


SCENARIOS = [managers, restarting_managers, slow_manager, strangers, alarms, programs, daemons,
             runner, firewall, orders, outage, restarts, disk, clock]


def main():
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    tables = pathlib.Path(sys.argv[1]).resolve().parent / "matrix"
    if sys.argv[2] == "--table":
        return 0 if print_table(tables) else 1
    scenario = next(each for each in SCENARIOS if each.__name__ == sys.argv[2])
    if os.geteuid() != 0:
        print("skipped: network namespaces and programs of an allow-list need root")
        return 77
    parent = pathlib.Path(sys.argv[1]).resolve().parent / "scenarios"
    parent.mkdir(exist_ok=True)
    directory = pathlib.Path(tempfile.mkdtemp(prefix=f"matrix.{scenario.__name__}.", dir=parent))
    rig = Rig(sys.argv[1], directory)
    rig.table = tables / f"{scenario.__name__}.txt"
    code = perform(scenario.__name__, scenario, rig)
    if code == 0:
        shutil.rmtree(directory)
    return code


if __name__ == "__main__":
    sys.exit(main())
