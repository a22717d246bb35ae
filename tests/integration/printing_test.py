"""What programs print: on a full disk, into a descriptor that is closed, to a reader that goes.

    printing_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import os
import pathlib
import subprocess
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
sys.dont_write_bytecode = True
from fleet import Fleet, Skipped, check, play  # noqa: E402

# Programs that people do not run: children of others, plugins and tests.
NOT_BY_HAND = {"rips-inspect", "rips-scan", "rips-plugin-blinding", "rips-test-hostile-plugin",
               "rips-bench"}
CONFIG_OF = {"rips-policy-server": "policy-server.yaml", "rips-sensor": "sensor.yaml",
             "rips-actuator": "actuator.yaml", "rips-exec": "actuator.yaml",
             "rips-fw": "actuator.yaml"}
FULL = "No space left on device"
READER_GONE = 141


def commands(fleet):
    """What each program prints without a server."""
    programs = {path.name for path in fleet.bin.iterdir()
                if path.name == "ripsctl" or path.name.startswith("rips-")} - NOT_BY_HAND
    check(set(CONFIG_OF) < programs, f"{fleet.bin} has {sorted(programs)}")
    for program in sorted(programs):
        path = fleet.path_of(program)
        yield [path, "--help"]
        if program != "rips-alarm":
            yield [path, "--version"]
        if program in CONFIG_OF:
            yield [path, "--check-config", "--config", fleet.dir / CONFIG_OF[program]]
    for words in (["man"], ["completion", "bash"],
                  ["audit", "export", fleet.dir / "server/audit"]):
        yield [fleet.path_of("ripsctl"), *words]


def run(fleet, command, redirection="", **options):
    """Runs it as a shell does, with `redirection`."""
    return subprocess.run(["sh", "-c", f'exec "$@" {redirection}', "sh", *map(str, command)],
                          stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=30,
                          env=fleet.env, **options)


def begin(fleet):
    fleet.prepare()
    fleet.server = fleet.start_server()
    fleet.write_agent_configs()
    # Something that the audit log holds.
    fleet.ripsctl("level", "raise", "r1", "--to", "ALERT", "--reason", "x")


def a_full_disk_is_an_error_of_every_program(fleet):
    begin(fleet)
    for command in commands(fleet):
        what = " ".join(map(str, command))
        good = run(fleet, command)
        check(good.returncode == 0 and good.stdout, f"{what}: {good.returncode}, {good.stderr}")
        full = run(fleet, command, ">/dev/full")
        check(full.returncode == 1 and FULL in full.stderr,
              f"{what}: on a full disk {full.returncode}, {full.stderr!r}")
        for closed in (">&-", "<&- >&-", "<&- >&- 2>&-"):
            ended = run(fleet, command, closed)
            check(ended.returncode in (0, 1), f"{what} {closed}: {ended.returncode}")
    check(fleet.level()["decided_level"] == "ALERT", "the server goes on")


def a_full_disk_cuts_no_file_in_silence(fleet):
    """A real file system, which takes the beginning."""
    if os.geteuid() != 0:
        raise Skipped("only root may mount file systems")
    begin(fleet)
    small = fleet.dir / "small"
    small.mkdir()
    for command in commands(fleet):
        whole = len(run(fleet, command).stdout)
        done = subprocess.run(
            ["unshare", "--mount", "--propagation", "private", "sh", "-c",
             'mount -t tmpfs -o size=4k none "$0" || exit 77; "$@" >"$0/out"; code=$?; '
             'stat -c %s "$0/out"; exit $code', small, *map(str, command)],
            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=30, env=fleet.env)
        if done.returncode == 77:
            raise Skipped(f"file systems cannot be mounted here: {done.stderr.strip()}")
        written = int(done.stdout)
        check((done.returncode, FULL in done.stderr) == ((0, False) if written == whole
                                                         else (1, True)),
              f"{command}: {written} of {whole} bytes, {done.returncode}, {done.stderr!r}")
    check(whole > 0, "something is printed")


def a_watch_ends_with_its_reader(fleet):
    begin(fleet)
    for words, lines in ((["robot", "watch"], 1), (["alert", "watch"], 0)):
        watch = subprocess.Popen(fleet.ripsctl_args(*words), stdin=subprocess.DEVNULL,
                                 stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=fleet.env)
        for _ in range(lines):
            check(b"r1" in watch.stdout.readline(), "the watch prints the robot")
        time.sleep(0 if lines else 0.5)
        watch.stdout.close()
        said = watch.stderr.read()
        check((watch.wait(5), said) == (READER_GONE, b""), f"{words}: {watch.returncode}, {said}")


SCENARIOS = [a_full_disk_is_an_error_of_every_program, a_full_disk_cuts_no_file_in_silence,
             a_watch_ends_with_its_reader]

if __name__ == "__main__":
    sys.exit(play(SCENARIOS, Fleet))
