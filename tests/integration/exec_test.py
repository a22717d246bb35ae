"""rips-exec as it is deployed: its units, its socket, its cgroups, and a whole robot's scripts.

    exec_test.py BINARIES SCENARIO   runs one; without SCENARIO prints their names
"""

import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import SOURCE, Fleet, Process, Skipped, check, perform  # noqa: E402
from protos import pb  # noqa: E402

LIMIT = 60  # seconds anything here may take on a busy machine
BEGUN, ENDED = 2, 3  # of rips.v1.ExecKind
UNITS = SOURCE / "deploy/systemd"


def until(holds, what):
    deadline = time.monotonic() + LIMIT
    while not holds():
        check(time.monotonic() < deadline, what)
        time.sleep(0.02)


def needs_root():
    if os.geteuid() != 0:
        raise Skipped("programs of an allow-list must belong to root")


class World:
    """A directory, programs that belong to root, and processes."""

    def __init__(self, binaries, directory):
        self.bin = pathlib.Path(binaries).resolve()
        self.dir = directory
        self.leftovers = [directory]
        self.processes = []

    def program(self, name, text, directory=None):
        # Every directory on the way must be root's alone, which /tmp is not.
        if directory is None:
            directory = pathlib.Path(tempfile.mkdtemp(prefix="rips-test-", dir="/opt"))
            directory.chmod(0o755)
            self.leftovers.append(directory)
        path = directory / name
        path.write_text("#!/bin/sh\n" + text)
        path.chmod(0o755)
        return path

    def config(self, more):
        path = self.dir / "actuator.yaml"
        path.write_text(f"""robot: r1
host: base
servers: ["127.0.0.1:1"]
tls: {{ca: /ca, cert: /cert, key: /key}}
fail_safe: {{level: keep, after: 0s}}
levels: [{{name: DEFAULT}}, {{name: ALERT}}]
{more}""")
        return path

    def start(self, name, *args):
        process = Process(name, args, self.dir, dict(os.environ))
        self.processes.append(process)
        return process

    def stop(self):
        for process in reversed(self.processes):
            process.kill()


def ask(path, program):
    """Starts a program of rips-exec and waits for its end: all ExecAnswers."""
    import socket
    call = pb("ExecCall")(verb="EXEC_VERB_START", name=program.encode(), drill=False,
                          level_from=b"", level_to=b"")
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as asking:
        asking.settimeout(LIMIT)
        asking.connect(str(path))
        asking.send(b"." + call.SerializeToString())
        answers, parts = [], b""
        while True:
            try:
                packet = asking.recv(1 << 16)
            except ConnectionResetError:
                continue
            if not packet:
                return answers
            parts += packet[1:]
            if packet[:1] == b".":
                answers.append(pb("ExecAnswer").FromString(parts))
                parts = b""


# ------------------------------------------------------------------------------------ scenarios


def units_are_valid(world):
    """systemd accepts the shipped units, and finds a mistake when there is one."""
    if shutil.which("systemd-analyze") is None:
        raise Skipped("systemd-analyze is not installed")
    root = world.dir / "root"
    units = root / "usr/lib/systemd/system"
    shutil.copytree("/usr/lib/systemd/system", units, symlinks=True)
    (root / "usr/bin").mkdir(parents=True)
    services = sorted(UNITS.glob("*.service"))
    daemons = ("exec", "fw", "actuator", "sensor", "wire", "policy-server")
    check({f"rips-{name}.service" for name in daemons} <= {unit.name for unit in services},
          f"units are missing: {services}")
    for unit in UNITS.iterdir():
        shutil.copy(unit, units)
    (root / "bin").symlink_to("usr/bin")
    programs = re.findall(r"^ExecStart=/usr/bin/(\S+)", "\n".join(
        service.read_text() for service in services), re.M)
    check(len(programs) == len(services), f"not each unit starts a program: {programs}")
    for program in [*programs, "kill"]:
        (root / "usr/bin" / program).write_bytes(b"")
        (root / "usr/bin" / program).chmod(0o755)

    def verify(unit):
        done = subprocess.run(["systemd-analyze", "verify", "--man=no", f"--root={root}", unit],
                              capture_output=True, text=True, timeout=LIMIT)
        return done.returncode, done.stdout + done.stderr

    for service in services:
        code, said = verify(service.name)
        check(code == 0 and not said.strip(), f"{service.name}: {said}")
        text = service.read_text()
        check("NoNewPrivileges=yes" in text and "ProtectSystem=strict" in text,
              f"{service.name} is not confined")
    broken = units / "rips-exec.service"
    broken.write_text(broken.read_text().replace("Delegate=yes", "Delegate=yes\nColour=red"))
    check("Colour" in verify("rips-exec.service")[1], "a mistake in a unit is not found")


def socket_activation(world):
    """The socket is there before rips-exec: whoever asks starts it."""
    needs_root()
    if shutil.which("systemd-socket-activate") is None:
        raise Skipped("systemd-socket-activate is not installed")
    path = world.dir / "exec.sock"
    hello = world.program("hello", "echo hello; ls /proc/self/fd | tr '\\n' ' '\n")
    config = world.config(f"""exec: {{socket: {path}, user: "0"}}
programs: [{{name: hello, path: {hello}}}]
""")
    listening = world.start("exec", "systemd-socket-activate", "--seqpacket", "-l", path,
                            world.bin / "rips-exec", "--config", config)
    until(path.exists, "nobody listens")
    begun, ended = ask(path, "hello")
    check(begun.kind == BEGUN and ended.kind == ENDED and ended.begun and ended.code == 0,
          f"the answers are {begun} {ended}")
    # 3 is the script itself, 4 the directory that ls reads.
    check(ended.output_tail == b"hello\n0 1 2 3 4 ", f"the program sees {ended.output_tail}")
    listening.wait_for(lambda line: " listening " in line, LIMIT, "rips-exec listens")


def what_a_killed_one_left_is_killed(world):
    """rips-exec is killed while a daemon of a program runs; the next one buries it."""
    needs_root()
    path = world.dir / "exec.sock"
    pids = world.dir / "pids"
    program = world.program("daemon", f"setsid sleep 600 & echo $! > {pids}.new\n"
                            f"mv {pids}.new {pids}\nsleep 600\n")
    config = world.config(f"""exec: {{socket: {path}, user: "0"}}
programs: [{{name: daemon, path: {program}, timeout: 5min}}]
""")
    first = world.start("exec", world.bin / "rips-exec", "--config", config)
    _, line = first.wait_for(lambda line: line if " listening " in line else None, LIMIT,
                             "rips-exec listens")
    if "cgroups=none" in line:
        raise Skipped("cgroup v2 cannot be used here")
    asking = world.start("asking", sys.executable, "-c",
                         f"import sys; sys.argv = ['']; sys.path.insert(0, '{pathlib.Path(__file__).parent}')\n"
                         f"import exec_test; exec_test.ask('{path}', 'daemon')")
    until(pids.exists, "the program does not run")
    daemon = int(pids.read_text())
    first.kill(signal.SIGKILL)
    until(lambda: not asking.running, "who asked is not told")
    check(pathlib.Path(f"/proc/{daemon}").exists(), "the daemon ended by itself")

    second = world.start("exec2", world.bin / "rips-exec", "--config", config)

    second.wait_for(lambda line: "killed processes left by a previous rips-exec" in line, LIMIT,
                    "it says so")
    second.wait_for(lambda line: " listening " in line, LIMIT, "rips-exec listens again")
    until(lambda: not alive(daemon), "the daemon lives")


def alive(pid):
    try:
        return "\nState:\tZ" not in pathlib.Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def without_cgroups(world):
    """Said once at the start and by --check-config; programs run all the same."""
    needs_root()
    path = world.dir / "exec.sock"
    nowhere = world.dir / "nowhere"
    nowhere.mkdir()
    hello = world.program("hello", "echo hello\n")
    config = world.config(f"""exec: {{socket: {path}, user: "0", cgroup: {nowhere}}}
programs: [{{name: hello, path: {hello}}}]
""")
    checked = subprocess.run([world.bin / "rips-exec", "--check-config", "--config", config],
                             capture_output=True, text=True, timeout=LIMIT)
    check(checked.returncode == 0 and "# warning: without cgroups" in checked.stdout,
          f"--check-config says {checked.stdout}")
    runner = world.start("exec", world.bin / "rips-exec", "--config", config)
    runner.wait_for(lambda line: "cgroups=none" in line, LIMIT, "rips-exec listens")
    check(b"hello" in ask(path, "hello")[-1].output_tail, "the program did not run")
    warned = [text for _, text in runner.lines if "without cgroups" in text]
    check(len(warned) == 1, f"warned {len(warned)} times")


def one_at_a_time(world):
    """A second rips-exec at the same socket ends, and kills nothing."""
    needs_root()
    path = world.dir / "exec.sock"
    config = world.config(f'exec: {{socket: {path}, user: "0"}}\n')
    first = world.start("exec", world.bin / "rips-exec", "--config", config)
    first.wait_for(lambda line: " listening " in line, LIMIT, "rips-exec listens")
    second = subprocess.run([world.bin / "rips-exec", "--config", config], capture_output=True,
                            text=True, timeout=LIMIT)
    check(second.returncode == 1 and "listens at" in second.stderr, f"it says {second.stderr}")
    check(first.running, "the first one ended")


def scripts_of_levels(world):
    """A robot whose levels have scripts: told where to and where from, shown, and heard of."""
    needs_root()
    log = world.dir / "log"
    text = f'$1 $2 $RIPS_LEVEL_FROM $RIPS_LEVEL_TO $RIPS_ROBOT" >> {log}\n'
    to = world.program("DEFAULT.to", 'echo "to ' + text)
    world.program("ALERT.from", 'echo "from ' + text, to.parent)
    fleet = Fleet(world.bin, world.dir / "fleet", floor_hold="1s")
    world.processes = fleet.processes
    fleet.programs = f"scripts: {to.parent}\n"
    fleet.arm()
    world.processes = fleet.processes
    checked = subprocess.run([world.bin / "rips-actuator", "--check-config", "--config",
                              fleet.dir / "actuator.yaml"], capture_output=True, text=True,
                             timeout=LIMIT)
    check("ALERT.from" in checked.stdout and "DEFAULT.to" in checked.stdout,
          f"--check-config says {checked.stdout}")

    # A fresh one starts at the fail-safe level and is then lowered.
    lines = log.read_text().splitlines()
    check(lines == ["from DEFAULT ALERT ALERT DEFAULT r1", "to DEFAULT ALERT ALERT DEFAULT r1"],
          f"the scripts said {lines}")
    # A file that is no level's keeps the actuator from starting.
    (to.parent / "ALARM.to").write_text("")
    checked = subprocess.run([world.bin / "rips-exec", "--check-config", "--config",
                              fleet.dir / "actuator.yaml"], capture_output=True, text=True,
                             timeout=LIMIT)
    check(checked.returncode == 2 and "ALARM.to` is of no level" in checked.stderr,
          f"it says {checked.stderr}")


SCENARIOS = [units_are_valid, socket_activation, what_a_killed_one_left_is_killed,
             without_cgroups, one_at_a_time, scripts_of_levels]


def main():
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    scenario = next(each for each in SCENARIOS if each.__name__ == sys.argv[2])
    # Short: the path of a socket has 107 bytes at most.
    directory = pathlib.Path(tempfile.mkdtemp(prefix="rips-exec-"))
    world = World(sys.argv[1], directory)
    code = perform(scenario.__name__, scenario, world)
    for leftover in world.leftovers:
        shutil.rmtree(leftover, ignore_errors=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
