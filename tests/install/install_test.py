"""The Debian packages of a build directory.

    install_test.py BUILD

RIPS_UPDATE_GOLDENS=1 rewrites contents.txt. RIPS_ROBOT_ROOT names a root directory in which the
agents are tried in place of this machine's. Nothing is installed on this machine: packages go into
a copy of its root directory, an overlay in memory that only this process sees. What cannot be tried
here is named in a line that begins with `skipped`.
"""

import difflib
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
sys.path[:0] = [str(SOURCE / "deploy/debian"), str(SOURCE / "tests/support")]
from fleet import Failed, Skipped, check  # noqa: E402
from make_packages import Failed as NotMade, QUICK, make_packages  # noqa: E402
from agents import agents_need_what_every_release_has, agents_run_on_a_robot, \
    what_one_release_lacks_is_refused  # noqa: E402
from overlay import APART, LIMIT, Overlay, run  # noqa: E402
from pages import commands_that  # noqa: E402

INSTALL_PAGE = "deploy/handbook/install.md"
EXPOSURE_MAX = 20  # of `systemd-analyze security`, in tenths


def needs(program):
    if not shutil.which(program):
        raise Skipped(f"{program} is missing")


def contents(packages):
    """PACKAGE MODE OWNER PATH of every file, a line each."""
    for package in packages:
        name = package.name.partition("_")[0]
        for line in run("dpkg-deb", "-c", package).stdout.splitlines():
            mode, owner, _, _, _, path = line.split(maxsplit=5)
            yield f"{name} {mode} {owner} {path}\n"


def each_file_where_it_belongs(world):
    golden = HERE / "contents.txt"
    now = list(contents(world.packages))
    if os.environ.get("RIPS_UPDATE_GOLDENS"):
        golden.write_text("".join(now))
    then = golden.read_text().splitlines(keepends=True)
    changes = "".join(difflib.unified_diff(then, now, "contents.txt", "the packages", n=0))
    check(not changes, f"RIPS_UPDATE_GOLDENS=1 accepts this:\n{changes}")


def same_build_same_bytes(world):
    other = world.dir / "another directory"
    for package in make_packages(world.build, other, QUICK):
        check(package.read_bytes() == (world.out / package.name).read_bytes(),
              f"{package.name} differs from that of the first time")


def lintian_finds_no_error(world):
    needs("lintian")
    run("lintian", "--allow-root", "--fail-on", "error", *world.packages)


def units_are_confined(world):
    needs("systemd-analyze")
    for unit in sorted((SOURCE / "deploy/systemd").glob("*.service")):
        run("systemd-analyze", "security", "--offline=true", "--no-pager",
            f"--threshold={EXPOSURE_MAX}", unit)


def broken_packages_are_not_made(world):
    """Without a program there is no package, and nothing half-written."""
    build = world.dir / "build"
    build.mkdir()
    (build / "cmake_install.cmake").write_text('message(FATAL_ERROR "no rips-sensor")\n')
    try:
        make_packages(build, world.dir / "none")
    except NotMade as why:
        check("no rips-sensor" in str(why), str(why))
    else:
        raise Failed("packages were made of nothing")
    check(not list((world.dir / "none").iterdir()), "something was left")


def installed_upgraded_removed_purged(world):
    if os.geteuid() != 0:
        raise Skipped("only root can install packages, also into a copy of the root directory")
    place = world.dir / "root"
    place.mkdir()
    if run(*APART, "true", ok=False).returncode != 0:
        raise Skipped("unshare is not allowed here")
    command = [*APART, sys.executable, "-B", __file__, "--inside", place, *world.packages]
    done = run(*command, ok=False, timeout=4 * LIMIT)
    if done.returncode == 77:
        raise Skipped(done.stdout.strip())
    check(done.returncode == 0, done.stdout)


# What follows runs in namespaces of its own, also of networks and processes.

PROGRAMS = {  # program -> its user
    "rips-policy-server": "rips-policy-server",
    "rips-sensor": "rips-sensor",
    "rips-actuator": "rips",
    "rips-exec": "rips-exec",
    "rips-fw": "rips-fw",
}
PRIVATE = {  # directory -> its mode, user and group
    "/etc/rips/pki/policy-server": "750 root rips-policy-server",
    "/etc/rips/pki/sensor": "750 root rips-sensor",
    "/etc/rips/pki/actuator": "750 root rips",
    "/var/lib/rips/policy-server": "700 rips-policy-server rips-policy-server",
    "/var/lib/rips/sensor": "700 rips-sensor rips-sensor",
    "/var/lib/rips/actuator": "700 rips rips",
    "/var/log/rips": "750 rips-policy-server rips-policy-server",
}
# In place of systemd, which does not run in the copy: they write down what they are asked for, and
# say that every unit is active but those of rips-wire.
FAKES = {
    "usr/bin/systemctl": """#!/bin/sh
echo "systemctl $*" >>/asked
case "$*" in *is-active*rips-wire*) exit 3 ;; esac
""",
    "usr/bin/deb-systemd-invoke": '#!/bin/sh\necho "$*" >>/asked\n',
}


def as_its_user(program):
    user = PROGRAMS[program]
    return ["setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups", program]


class Copy(Overlay):
    """A host on which everything is installed."""

    def __init__(self, place):
        super().__init__(place)
        # What this machine has of RIPS does not count.
        known = run("dpkg-query", "-W", "-f", "${Package}\n").stdout
        there = re.findall(r"^(rips-\S+)", known, re.M)
        if there:
            self.run("dpkg", "--purge", *there)
        for name in ("etc/rips", "var/lib/rips", "var/log/rips"):
            shutil.rmtree(self.root / name, ignore_errors=True)

    def asked(self):
        """What the fakes were asked since the last call, but for whether units are active."""
        log = self.root / "asked"
        lines = log.read_text().splitlines() if log.exists() else []
        log.unlink(missing_ok=True)
        return [line for line in lines if "is-active" not in line]

    def check_config(self, program, ok=True):
        return self.run(*as_its_user(program), "--check-config", ok=ok)

    def start(self, program):
        with open(self.path("/tmp/daemons.log"), "a", encoding="utf-8") as log:
            return subprocess.Popen(["chroot", str(self.root), *as_its_user(program)], stdout=log,
                                    stderr=log)


def next_version(packages, out):
    """The same packages with a higher version."""
    for package in packages:
        tree = out / "tree"
        run("dpkg-deb", "-R", package, tree)
        control = tree / "DEBIAN/control"
        text = control.read_text()
        version = re.search(r"^Version: (.*)$", text, re.M)[1]
        for place in ("Version: {}\n", "(= {})"):
            text = text.replace(place.format(version), place.format(f"{version}+1"))
        control.write_text(text)
        run("dpkg-deb", "--root-owner-group", "-Znone", "--build", tree, out / package.name)
        shutil.rmtree(tree)
        yield out / package.name


def check_directories(copy):
    for name, expected in PRIVATE.items():
        found = copy.run("stat", "-c", "%a %U %G", name).stdout.strip()
        check(found == expected, f"{name} is {found}, not {expected}")


def check_after_installation(copy):
    check_directories(copy)
    found = copy.run("stat", "-c", "%a %U %G", "/run/rips").stdout.strip()
    check(found == "1775 root rips-sensor", f"/run/rips is {found}")
    live = [path.name for path in copy.path("/etc/rips").iterdir()]
    check(sorted(live) == ["bundles", "pki"], f"/etc/rips has {live}: a daemon could start")
    enabled = list(copy.path("/etc/systemd/system").glob("*.wants/rips*"))
    check(not enabled, f"{enabled} are enabled")
    check(not copy.asked(), "systemd does not run, and was asked for something")
    done = copy.run("systemd-analyze", "verify", *[
        f"/lib/systemd/system/{unit.name}" for unit in (SOURCE / "deploy/systemd").iterdir()])
    mine = [line for line in done.stdout.splitlines() if "rips" in line]
    check(not mine, "systemd-analyze verify says:\n" + "\n".join(mine))


def follow_the_handbook(copy):
    """Everything on one host. The examples name another server, and a network that is not there."""
    commands = commands_that("packages", INSTALL_PAGE)
    kinds = {command.split()[0] for command in commands}
    expected = {"rips-mint", "apt-get", "install", "cp", "runuser", "systemctl"}
    check(kinds == expected, f"{INSTALL_PAGE} has {kinds}")
    units = {path.name for path in (SOURCE / "deploy/systemd").iterdir()}
    for command in commands:
        words = command.split()
        if words[0] == "systemctl":
            named = {word if "." in word else f"{word}.service" for word in words[3:]}
            check(words[1:3] == ["enable", "--now"] and named <= units, f"what is `{command}`?")
        elif words[0] == "apt-get":
            # dpkg does what apt-get would do with packages that are there.
            copy.run("bash", "-c", f"cd /tmp/packages && dpkg -i {' '.join(words[2:])}")
        else:
            copy.run("bash", "-c", f"cd /tmp/packages && {command}")
    for name in ("sensor", "actuator"):
        path = copy.path(f"/etc/rips/{name}.yaml")
        path.write_text(path.read_text().replace("policy.example", "127.0.0.1")
                        .replace("interface: eth0", "interface: lo"))


def daemons_work_together(copy):
    """As installed and by their own users: the server, and both agents of the robot. The helpers
    want sockets that systemd opens."""
    run("ip", "link", "set", "lo", "up")
    daemons = [copy.start(program) for program in
               ("rips-policy-server", "rips-sensor", "rips-actuator")]
    alice = "/tmp/packages/fleet/operator/admin/alice"
    ripsctl = ["ripsctl", "--server", "127.0.0.1:7443", "--cert", f"{alice}/cert.pem", "--key",
               f"{alice}/key.pem", "--ca", f"{alice}/ca.pem"]
    deadline = time.monotonic() + LIMIT
    while True:
        done = copy.run(*ripsctl, "agent", "list", ok=False)
        agents = re.findall(r"/robot/r1/(sensor|actuator)/base", done.stdout)
        if {"sensor", "actuator"} <= set(agents):
            break
        ended = [f"{daemon.args}: {daemon.returncode}" for daemon in daemons if daemon.poll()]
        check(not ended and time.monotonic() < deadline,
              f"{ended}\n{done.stdout}\n{copy.path('/tmp/daemons.log').read_text()}")
        time.sleep(0.2)
    for daemon in daemons:
        daemon.terminate()
    for daemon in daemons:
        check(daemon.wait(LIMIT) == 0, f"{daemon.args} ended with {daemon.returncode}")


def check_configurations(copy):
    """As their users, who must be able to read what they need."""
    for program in PROGRAMS:
        copy.check_config(program)
    for program, directory in (("rips-policy-server", "/var/log/rips"),
                               ("rips-policy-server", "/var/lib/rips/policy-server"),
                               ("rips-sensor", "/var/lib/rips"),
                               ("rips-actuator", "/var/lib/rips")):
        copy.path(directory).rename(copy.path("/elsewhere"))
        done = copy.check_config(program, ok=False)
        copy.path("/elsewhere").rename(copy.path(directory))
        check(done.returncode == 2 and f"`{directory}`, which does not exist" in done.stdout,
              f"{program} without {directory}: {done.returncode} {done.stdout}")
    inventory = copy.path("/etc/rips/robots.yaml")
    text = inventory.read_text()
    inventory.write_text("robots: 7\n")
    done = copy.check_config("rips-policy-server", ok=False)
    inventory.write_text(text)
    check(done.returncode == 2 and "robots.yaml:1" in done.stdout, f"it says {done.stdout}")


def check_tools(copy):
    """ripsctl and the server find rips-inspect and rips-scan where the package has them."""
    copy.run("ripsctl", "rules", "test",
             "/usr/share/rips/policies/payload-guard/payload-guard_test.yaml")
    bundle = "/usr/lib/rips/bundles/camera-guard"
    copy.run("ripsctl", "rules", "check", bundle)
    copy.run("ripsctl", "rules", "test", f"{bundle}/camera-guard_test.yaml")
    copy.run("bash", "-n", "/usr/share/bash-completion/completions/ripsctl")
    if copy.path("/usr/sbin/logrotate").exists():
        alerts = copy.path("/var/log/rips/alerts.jsonl")
        alerts.write_text("{}\n")
        copy.run("chown", "rips-policy-server:", "/var/log/rips/alerts.jsonl")
        copy.run("logrotate", "--force", "--state", "/tmp/state",
                 "/etc/logrotate.d/rips-policy-server")
        moved = list(alerts.parent.iterdir())
        check(len(moved) == 1 and moved[0].name.startswith("alerts.jsonl-2"), f"it left {moved}")


def fake_systemd(copy):
    copy.path("/run/systemd/system").mkdir(parents=True)
    for name, text in FAKES.items():
        (copy.root / name).unlink(missing_ok=True)
        (copy.root / name).write_text(text)
        (copy.root / name).chmod(0o755)


def leave_marks(copy):
    for name in PRIVATE:
        (copy.path(name) / "mark").write_text("mine\n")
    copy.path("/var/lib/rips/sensor").chmod(0o750)  # as the administrator wants it
    wants = copy.path("/etc/systemd/system/multi-user.target.wants")
    wants.mkdir(exist_ok=True)
    (wants / "rips-sensor.service").symlink_to("/lib/systemd/system/rips-sensor.service")


def check_marks(copy):
    for name in PRIVATE:
        check((copy.path(name) / "mark").read_text() == "mine\n", f"{name} has lost what was in it")


def check_upgrade(copy, packages):
    """One daemon's configuration is refused by the new version."""
    configuration = copy.path("/etc/rips/sensor.yaml")
    text = configuration.read_text()
    configuration.write_text(text + "colour: red\n")
    said = copy.install(packages)
    asked = copy.asked()
    restarted = sorted(line.split()[1] for line in asked if line.startswith("restart "))
    expected = ["rips-actuator.service", "rips-exec.service", "rips-fw.service",
                "rips-policy-server.service"]
    check(restarted == expected, f"restarted {restarted}, not {expected}\n{said}")
    check("rips-sensor.service is NOT restarted" in said and "unknown key `colour`" in said, said)
    check("systemctl --system daemon-reload" in asked, f"only asked for {asked}")
    configuration.write_text(text)
    check_marks(copy)
    found = copy.run("stat", "-c", "%a", "/var/lib/rips/sensor").stdout.strip()
    check(found == "750", "the upgrade has changed the mode that the administrator chose")
    copy.install(packages)  # the same again
    check("restart rips-sensor.service" in copy.asked(), "it was not restarted")


def check_removal(copy, names, packages):
    copy.run("dpkg", "--remove", *names)
    asked = copy.asked()
    for unit in (SOURCE / "deploy/systemd").iterdir():
        if "\nType=oneshot\n" in unit.read_text():
            continue  # it ends of itself
        check(f"stop {unit.name}" in asked, f"{unit.name} was not stopped: {asked}")
    check_marks(copy)
    check(copy.path("/etc/rips/sensor.yaml").exists(), "the configuration is gone")
    check(not list(copy.path("/usr/bin").glob("rips*")), "programs are left")
    # And back: what was kept is in use again.
    shutil.rmtree(copy.path("/var/lib/rips/actuator"))
    copy.install(packages)
    copy.path("/var/lib/rips/actuator/mark").write_text("mine\n")
    check_marks(copy)
    copy.path("/var/lib/rips/sensor").chmod(0o700)
    check_directories(copy)


def check_purge(copy, names):
    copy.run("dpkg", "--purge", *names)
    left = sorted(str(path.relative_to(copy.root)) for directory in ("etc", "usr", "var")
                  for path in copy.path(directory).rglob("*rips*")
                  if not os.path.lexists("/" / path.relative_to(copy.root)))
    check(left == ["etc/rips"], f"the purge leaves {left}")
    kept = sorted(path.name for path in copy.path("/etc/rips").iterdir())
    written = ["actuator.yaml", "alert.nft", "bundles", "policy-server.yaml", "robots.yaml",
               "sensor.yaml", "smh.yaml"]
    check(kept == written, f"of what the administrator wrote the purge leaves {kept}")


def inside(place, packages):
    copy = Copy(place)
    names = [package.name.partition("_")[0] for package in packages]
    newer = place / "newer"
    newer.mkdir()
    copy.install(packages)
    check_after_installation(copy)
    follow_the_handbook(copy)
    check_configurations(copy)
    daemons_work_together(copy)
    check_tools(copy)
    fake_systemd(copy)
    leave_marks(copy)
    packages = list(next_version(packages, newer))
    check_upgrade(copy, packages)
    check_removal(copy, names, packages)
    check_purge(copy, names)


class World:
    def __init__(self, build, directory):
        self.build, self.dir = build, directory
        self.out = directory / "packages"
        self.packages = make_packages(build, self.out, QUICK)


STEPS = [each_file_where_it_belongs, lintian_finds_no_error, units_are_confined,
         broken_packages_are_not_made, same_build_same_bytes, agents_need_what_every_release_has,
         what_one_release_lacks_is_refused, agents_run_on_a_robot,
         installed_upgraded_removed_purged]


def perform(step, world):
    """Whether it passed or was skipped."""
    try:
        step(world)
    except Skipped as skipped:
        print(f"skipped {step.__name__}: {skipped}")
    except (Failed, NotMade, OSError, subprocess.TimeoutExpired) as failed:
        print(f"FAILED {step.__name__}: {failed}")
        return False
    else:
        print(f"passed {step.__name__}")
    return True


def main():
    os.umask(0o022)
    if sys.argv[1] == "--inside":
        try:
            inside(pathlib.Path(sys.argv[2]), [pathlib.Path(name) for name in sys.argv[3:]])
        except Skipped as skipped:
            print(skipped)
            return 77
        except (Failed, OSError) as failed:
            print(failed)
            return 1
        return 0
    for program in ("dpkg-shlibdeps", "patchelf"):
        if not shutil.which(program):
            print(f"skipped packages: {program} is missing; run "
                  "./deploy/install-packages deploy/debian/packages")
            return 77
    with tempfile.TemporaryDirectory(prefix="rips-packages-test-") as directory:
        try:
            world = World(pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(directory))
        except NotMade as why:
            print(f"FAILED to make the packages: {why}")
            return 1
        passed = [perform(step, world) for step in STEPS]
    return 0 if all(passed) else 1


if __name__ == "__main__":
    sys.exit(main())
