"""Steps of install_test.py: the agents' packages install and run on each release a robot may have.

Debian 12, Ubuntu 22.04 and Ubuntu 24.04. What their programs and libraries need is compared with
what all three have; then they run in a root directory that has none of the libraries they carry.
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
sys.path[:0] = [str(SOURCE / "tests/support"), str(SOURCE / "tests/integration")]
from fleet import Failed, Fleet, Skipped, check  # noqa: E402
from overlay import APART, LIMIT, Overlay, run  # noqa: E402
from security_test import ROBOT, Keystore  # noqa: E402

CARRIED = "usr/lib/rips/lib"
AGENTS = ("rips-common", "rips-agent-libs", "rips-sensor", "rips-actuator", "rips-enrol")
PROGRAMS = ("rips-sensor", "rips-wire", "rips-actuator", "rips-exec", "rips-fw", "rips-alarm",
            "rips-enrol")
# What all three releases have: sonames, and the package that each is in.
HOST_LIBRARIES = {
    "ld-linux-x86-64.so.2": "libc6", "ld-linux-aarch64.so.1": "libc6", "libc.so.6": "libc6",
    "libm.so.6": "libc6", "libstdc++.so.6": "libstdc++6", "libgcc_s.so.1": "libgcc-s1",
    "libssl.so.3": "libssl3", "libcrypto.so.3": "libssl3", "libz.so.1": "zlib1g",
    "libacl.so.1": "libacl1", "libudev.so.1": "libudev1"}
# The oldest version of each package: that of Ubuntu 22.04. (24.04 has libssl3 by a versioned
# Provides of libssl3t64.)
HOST_PACKAGES = {"libc6": "2.35", "libstdc++6": "12", "libgcc-s1": "12", "libssl3": "3.0.2",
                 "zlib1g": "1:1.2.11", "libacl1": "2.3.1", "libudev1": "249"}
# The newest symbol versions of these.
HOST_SYMBOLS = {"GLIBC": "2.35", "GLIBCXX": "3.4.30", "CXXABI": "1.3.13", "GCC": "12.0",
                "OPENSSL": "3.0.2", "ZLIB": "1.2.9", "ACL": "1.2", "LIBUDEV": "247"}
HOST_NAMES = tuple(soname.partition(".so")[0] + ".so" for soname in HOST_LIBRARIES)
SYSTEMD = re.compile(r"systemd(-standalone)?(-sysusers|-tmpfiles)?")


def numbers(version):
    return [int(part) for part in version.split(".")]


def check_needs(name, text, carried):
    """That an ELF file needs only libraries of the host and carried ones, in versions they have.
    `text` is what `objdump -p` says of it."""
    for soname in re.findall(r"^\s+NEEDED\s+(\S+)", text, re.M):
        check(soname in carried or soname in HOST_LIBRARIES,
              f"{name} needs {soname}, which is neither in rips-agent-libs nor on every release")
    references = text.partition("Version References:")[2]
    for symbol in re.findall(r"^\s+0x\S+ 0x\S+ \d+ (\S+)", references, re.M):
        known = re.fullmatch(r"([A-Z]+)_(\d+(?:\.\d+)*)", symbol)
        check(known and numbers(known[2]) <= numbers(HOST_SYMBOLS.get(known[1], "0")),
              f"{name} needs {symbol}, which not every release has")
    path = re.findall(r"^\s+(RPATH|RUNPATH)\s+(\S+)$", text, re.M)
    wanted = [] if name in carried else [("RPATH", "$ORIGIN/../lib/rips/lib")]
    check(path == wanted, f"{name} looks for libraries in {path}, not in {wanted}")


def check_dependency(name, dependency, version):
    """One alternative of a package's Depends."""
    package, relation, wanted = re.fullmatch(r"(\S+)(?: \((\S+) (\S+)\))?", dependency).groups()
    if package in AGENTS:
        check((relation, wanted) == ("=", version), f"{name} depends on {dependency}")
    elif not SYSTEMD.fullmatch(package):
        check(package in HOST_PACKAGES, f"{name} depends on {package}, which not every release has")
        check(relation == ">=" and run("dpkg", "--compare-versions", wanted, "le",
                                       HOST_PACKAGES[package], ok=False).returncode == 0,
              f"{name} depends on {dependency}; Ubuntu 22.04 has {HOST_PACKAGES[package]}")


def agent_packages(packages):
    return [package for package in packages if package.name.partition("_")[0] in AGENTS]


def agents_need_what_every_release_has(world):
    packages = agent_packages(world.packages)
    check(len(packages) == len(AGENTS), f"there are only {packages}")
    tree = world.dir / "agents"
    for package in packages:
        run("dpkg-deb", "-x", package, tree)
        name, version = package.name.split("_")[:2]
        depends = run("dpkg-deb", "--field", package, "Depends").stdout
        for dependency in re.split(r"[,|]", depends):
            check_dependency(name, dependency.strip(), version)
    files = [path for path in sorted(tree.rglob("*"))
             if path.is_file() and path.read_bytes()[:4] == b"\x7fELF"]
    carried = {path.name for path in (tree / CARRIED).iterdir()}
    check({file.name for file in files} == carried | set(PROGRAMS), f"the programs are {files}")
    for file in files:
        check_needs(file.name, run("objdump", "-p", file).stdout, carried)
    doc = tree / "usr/share/doc/rips-agent-libs"
    listed = {line.split()[0]: line.split()[1] for line in
              (doc / "LIBRARIES").read_text().partition("\nLIBRARY")[2].splitlines()[1:]}
    check(set(listed) == carried, f"LIBRARIES lists {sorted(listed)}")
    check(set(listed.values()) == {path.name for path in (doc / "licences").iterdir()},
          "a licence is missing")


def what_one_release_lacks_is_refused(_):
    """The checks above find what they are there for."""
    version = "Version References:\n  required from it:\n    0x0d696914 0x00 02 {}\n"
    path = "  RPATH                $ORIGIN/../lib/rips/lib\n"
    good = [path + version.format("GLIBC_2.35"), path + "  NEEDED               libssl.so.3\n"]
    bad = [path + version.format("GLIBC_2.36"), path + version.format("GLIBC_ABI_DT_RELR"),
           path + version.format("GLIBCXX_3.4.31"), path + version.format("OPENSSL_3.0.9"),
           path + "  NEEDED               libyara.so.9\n", path.replace("RPATH", "RUNPATH"), ""]
    for text in good:
        check_needs("rips-sensor", text, ())
    check_dependency("rips-sensor", "libc6 (>= 2.35)", "1")
    tries = [lambda text=text: check_needs("rips-sensor", text, ()) for text in bad]
    tries += [lambda text=text: check_dependency("rips-sensor", text, "1") for text in
              ("libc6 (>= 2.36)", "libssl3t64 (>= 3.0.2)", "libgrpc29 (>= 1.51)", "rips-common")]
    for number, attempt in enumerate(tries):
        try:
            attempt()
        except Failed:
            continue
        raise Failed(f"case {number} is not refused")


def agents_run_on_a_robot(world):
    """In a root directory without the libraries: this machine's, less those, or RIPS_ROBOT_ROOT."""
    if os.geteuid() != 0:
        raise Skipped("only root can install packages, also into a copy of the root directory")
    if run(*APART, "true", ok=False).returncode != 0:
        raise Skipped("unshare is not allowed here")
    place = world.dir / "robot"
    place.mkdir()
    lower = os.environ.get("RIPS_ROBOT_ROOT", "/")
    done = run(*APART, sys.executable, "-B", __file__, place, lower, world.build / "bin",
               *agent_packages(world.packages), ok=False, timeout=3 * LIMIT)
    if done.returncode == 77:
        raise Skipped(done.stdout.strip())
    check(done.returncode == 0, done.stdout)


# What follows runs in namespaces of its own.


class AgentsOfTheRobot(Fleet):
    """The server and the robot's nodes are this machine's, the agents those of the packages."""

    def __init__(self, binaries, directory, overlay):
        super().__init__(binaries, directory, floor_hold="1s")
        self.overlay = overlay
        self.smh = self.dir / "smh.yaml"
        shutil.copyfile(SOURCE / "tests/support/robot_sim/smh.yaml", self.smh)

    def start(self, name, *args):
        if pathlib.Path(args[0]).name in PROGRAMS:
            args = ("chroot", self.overlay.root, pathlib.Path(args[0]).name, *args[1:])
        return super().start(name, *args)


def remove_libraries(overlay):
    """Of the Debian packages that the carried ones come from."""
    for directory in overlay.path("/usr/lib").glob("*-linux-gnu"):
        for name in overlay.path(CARRIED).iterdir():
            (directory / name.name).unlink(missing_ok=True)
        for plugins in directory.glob("libddsc*debian"):
            shutil.rmtree(plugins)


def check_libraries(overlay):
    """Where the dynamic linker finds them."""
    for program in PROGRAMS:
        said = overlay.run("ldd", f"/usr/bin/{program}").stdout
        for soname, path in re.findall(r"(\S+) => (.+)", said):
            check("/lib/rips/lib/" in path or soname in HOST_LIBRARIES and path.startswith("/"),
                  f"{program} finds {soname} at {path}")


def check_maps(fleet, secured):
    """What the agents have loaded, with the plugins of DDS Security."""
    for agent in (fleet.sensor, fleet.actuator):
        maps = fleet.overlay.path(f"/proc/{agent.child.pid}/maps").read_text()
        for path in sorted(set(re.findall(r"/\S+/lib\S+\.so\S*", maps))):
            directory, name = os.path.split(path)
            check(directory.endswith("/" + CARRIED) or name.startswith(HOST_NAMES),
                  f"the {agent.name} has loaded {path}")
        check(("libdds_security_auth.so" in maps) == secured,
              f"DDS Security: {secured}, and the {agent.name} has loaded:\n{maps}")


def robot_is_protected(overlay, binaries, directory, secured):
    """The sensor sees the robot's nodes and an intruder; the actuator switches the robot."""
    fleet = AgentsOfTheRobot(binaries, directory, overlay)
    intruder = []
    if secured:
        keys = Keystore(fleet.dir / "keystore")
        for enclave, kind in ROBOT.items():
            keys.mint(enclave, *kind)
        fleet.keystore = keys.dir
        intruder = ["--node", "/rogue", *keys.mint("/rogue", "node")]
    try:
        fleet.arm(*(("--keystore", fleet.keystore) if secured else ()))
        check_maps(fleet, secured)
        graph = fleet.ripsctl("robot", "graph", "r1")[1]
        check("/camera" in graph and "/navigator" in graph, f"the sensor sees only:\n{graph}")
        fleet.start_intruder("rogue-cmd-vel", *intruder)
        fleet.wait_level("COMPROMISED", 40)
    except Failed as failed:
        logs = "".join(f"--- {each.name}\n" + "\n".join(text for _, text in each.lines[-15:]) + "\n"
                       for each in fleet.processes)
        raise Failed(f"{logs}DDS Security: {secured}: {failed}") from failed
    finally:
        fleet.stop()


def as_user(user):
    return ["setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups"]


def inside(place, lower, binaries, packages):
    overlay = Overlay(place, lower)
    overlay.install(packages)
    remove_libraries(overlay)
    check_libraries(overlay)
    for program in PROGRAMS:
        overlay.run(program, "--help" if program in ("rips-alarm", "rips-enrol") else "--version")
    overlay.run("cp", "/usr/share/doc/rips-sensor/examples/sensor.yaml", "/etc/rips/")
    overlay.run(*as_user("rips-sensor"), "rips-sensor", "--check-config")
    # With capabilities, as their units start them, they look for libraries in the same way.
    for user, program, capability in (("rips-fw", "rips-fw", "+net_admin"),
                                      ("rips-sensor", "rips-wire", "+net_raw")):
        overlay.run(*as_user(user), f"--inh-caps={capability}", f"--ambient-caps={capability}",
                    program, "--version")
    run("ip", "link", "set", "lo", "up")
    for secured in (False, True):
        with tempfile.TemporaryDirectory(prefix="rips-robot-") as directory:
            shared = overlay.path(directory)
            shared.mkdir(parents=True)
            run("mount", "--bind", directory, shared)
            robot_is_protected(overlay, binaries, pathlib.Path(directory), secured)
            run("umount", shared)


def main():
    os.umask(0o022)
    place, lower, binaries, *packages = sys.argv[1:]
    try:
        inside(pathlib.Path(place), lower, binaries, [pathlib.Path(name) for name in packages])
    except Skipped as skipped:
        print(skipped)
        return 77
    except (Failed, OSError, subprocess.TimeoutExpired) as failed:
        print(failed)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
