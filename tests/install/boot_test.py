"""The packages under a real systemd: a container that boots, with the server and one robot in it.

    boot_test.py BUILD

The container's root directory is an overlay in memory over this machine's, its network is its own,
and all its processes end with this one. Where a container cannot boot, the test ends with 77.
"""

import json
import os
import pathlib
import re
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
SOURCE = HERE.parents[1]
sys.path[:0] = [str(SOURCE / "deploy/debian"), str(SOURCE / "tests/support")]
from fleet import Failed, Skipped, check  # noqa: E402
from make_packages import Failed as NotMade, QUICK, make_packages  # noqa: E402

LIMIT = 120  # seconds that a command or a change of state may take on a busy machine
UNSHARE = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc", "--propagation",
           "private"]
DAEMONS = ("rips-policy-server", "rips-sensor", "rips-actuator")
# What it boots: nothing of this machine's own services.
TARGET = """[Unit]
Requires=basic.target dbus.service
After=basic.target dbus.service
AllowIsolate=yes
"""
ACTUATOR = """robot: r1
host: base
servers: ["127.0.0.1:7443"]
tls: {ca: /etc/rips/pki/actuator/ca.pem, cert: /etc/rips/pki/actuator/cert.pem,
      key: /etc/rips/pki/actuator/key.pem}
state_dir: /var/lib/rips/actuator
dds: {domain: 0, interface: lo}
system_modes: {smh: /etc/rips/smh.yaml, verify: parts}
fail_safe: {level: ALERT, after: 0s}
levels:
  - {name: DEFAULT, enter: [{system_mode: {part: /safety, mode: __DEFAULT__}}]}
  - {name: ALERT, enter: [{system_mode: {part: /safety, mode: ALERT}}]}
  - name: COMPROMISED
    enter: [{system_mode: {part: /safety, mode: COMPROMISED}}, {program: {name: note}}]
  - {name: HALT, enter: [{system_mode: {part: /safety, mode: HALT}}]}
programs:
  - {name: note, path: /usr/bin/true, timeout: 10s}
metrics: "127.0.0.1:9466"
"""


def held(level):
    """How the actuator says it: the robot's mode was read back."""
    return f"^level {level}, verified;( floor [^;]*;)? connected$"


# Of the container's administrator.
HOME = pathlib.PurePosixPath("/root")
ALICE = HOME / "fleet/operator/admin/alice"
RIPSCTL = ("ripsctl", "--server", "127.0.0.1:7443", "--cert", f"{ALICE}/cert.pem", "--key",
           f"{ALICE}/key.pem", "--ca", f"{ALICE}/ca.pem")

ROBOT = ("/usr/local/bin/robot_sim", "--domain", "0", "--interface", "lo")


def robot(command):
    """The beginning of a command of the simulated robot."""
    return ROBOT[0], command, *ROBOT[1:]


def run(*command, ok=True, **options):
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, text=True, timeout=LIMIT, **options)
    check(not ok or done.returncode == 0,
          f"`{' '.join(map(str, command))}` ended with {done.returncode}:\n{done.stdout}")
    return done


def wait_until(holds, what):
    """`holds` is tried again and again; `what` returns the text of the error."""
    deadline = time.monotonic() + LIMIT
    while not holds():
        check(time.monotonic() < deadline, what())
        time.sleep(0.2)


class Cgroup:
    """One of our own, so that systemd in the container has one to itself."""

    def __init__(self):
        tops = [path for path in ("/sys/fs/cgroup", "/sys/fs/cgroup/unified")
                if os.path.exists(f"{path}/cgroup.procs")
                and os.path.exists(f"{path}/cgroup.controllers")]
        if not tops:
            raise Skipped("there is no cgroup v2 here")
        self.top = pathlib.Path(tops[0])
        self.own = self.top / f"rips-boot-test-{secrets.token_hex(4)}"
        self.before = self.top / self._mine().lstrip("/")
        try:
            self.own.mkdir()
            (self.own / "cgroup.procs").write_text("0")
        except OSError as why:
            self.remove()
            raise Skipped(f"no cgroup can be made here: {why}") from why

    @staticmethod
    def _mine():
        return re.search(r"^0::(.*)$", pathlib.Path("/proc/self/cgroup").read_text(), re.M)[1]

    def remove(self):
        try:
            (self.before / "cgroup.procs").write_text("0")
        except OSError:
            pass
        for path in sorted(self.own.rglob("*"), reverse=True):
            if path.is_dir():
                path.rmdir()
        if self.own.exists():
            self.own.rmdir()


class Machine:
    """A container that has booted."""

    def __init__(self, place):
        if run("mount", "-t", "tmpfs", "rips-test", place, ok=False).returncode != 0:
            raise Skipped("file systems cannot be mounted here")
        for name in ("upper", "work", "root"):
            (place / name).mkdir()
        self.root = place / "root"
        if run("mount", "-t", "overlay", "rips-test", "-o", f"lowerdir=/,upperdir={place}/upper,"
               f"workdir={place}/work", self.root, ok=False).returncode != 0:
            raise Skipped("overlay file systems are not allowed here")
        self._forget_rips()
        (self.root / "etc/machine-id").write_text("")
        # An image's own rule that packages start and stop nothing.
        (self.root / "usr/sbin/policy-rc.d").unlink(missing_ok=True)
        (self.root / "etc/systemd/system/rips-test.target").write_text(TARGET)
        self.log = place / "console"
        with open(self.log, "w", encoding="utf-8") as log:
            self.nspawn = subprocess.Popen(
                ["systemd-nspawn", "--quiet", "--boot", f"--directory={self.root}",
                 f"--machine=rips-boot-{secrets.token_hex(4)}", "--private-network", "--register=no", "--keep-unit",
                 "--console=pipe", "--link-journal=no", "systemd.unit=rips-test.target"],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                env={**os.environ, "SYSTEMD_NSPAWN_UNIFIED_HIERARCHY": "1"})
        self.leader = None
        deadline = time.monotonic() + LIMIT
        while not self._booted():
            if self.nspawn.poll() is not None or time.monotonic() > deadline:
                self.stop()
                raise Skipped("a container does not boot here: "
                              + " ".join(self.log.read_text(errors="replace").split())[-300:])
            time.sleep(0.2)

    def _forget_rips(self):
        """What this machine has of RIPS does not count."""
        known = run("dpkg-query", "-W", "-f", "${Package}\n").stdout
        there = re.findall(r"^(rips-\S+)", known, re.M)
        if there:
            run("chroot", self.root, "dpkg", "--purge", *there)
        for name in ("etc/rips", "var/lib/rips", "var/log/rips"):
            shutil.rmtree(self.root / name, ignore_errors=True)

    def _booted(self):
        children = pathlib.Path(f"/proc/{self.nspawn.pid}/task/{self.nspawn.pid}/children")
        if self.leader is None:
            try:
                found = children.read_text().split()
            except OSError:
                return False
            if not found:
                return False
            self.leader = found[0]
        state = self.run("systemctl", "is-system-running", ok=False).stdout.split()
        return bool(state) and state[-1] in ("running", "degraded")

    def run(self, *command, ok=True):
        return run("nsenter", "--target", self.leader, "--mount", "--uts", "--ipc", "--net", "--pid",
                   "--cgroup", "--root", "--wd", *command, ok=ok,
                   env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "LC_ALL": "C.UTF-8",
                        "HOME": str(HOME), "DEBIAN_FRONTEND": "noninteractive"})

    def script(self, text):
        return self.run("bash", "-euc", f"cd {HOME}\n{text}").stdout

    def path(self, name):
        """A file of the container."""
        return self.root / name.lstrip("/")

    def show(self, unit, name):
        return self.run("systemctl", "show", "--value", "-p", name, unit).stdout.strip()

    def status(self, unit):
        return self.run("systemctl", "--no-pager", "status", unit, ok=False).stdout

    def await_status(self, unit, pattern):
        """Active, and its own line is like that."""
        wait_until(lambda: self.show(unit, "ActiveState") == "active"
                   and re.search(pattern, self.show(unit, "StatusText")),
                   lambda: f"{unit} does not say `{pattern}`:\n{self.status(unit)}")

    def start(self, unit, *command):
        """A process of the robot, not of RIPS."""
        self.run("systemd-run", "--quiet", f"--unit={unit}", *command)

    def stop(self):
        if self.nspawn.poll() is None and self.leader is not None:
            self.nspawn.terminate()  # nspawn orders an orderly shutdown
            try:
                self.nspawn.wait(20)
            except subprocess.TimeoutExpired:
                pass
        if self.nspawn.poll() is None:
            self.nspawn.send_signal(signal.SIGKILL)
            self.nspawn.wait(LIMIT)


def install(machine, packages):
    target = machine.path(f"{HOME}/packages")
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    for package in packages:
        shutil.copy(package, target)
    return machine.script("dpkg -i packages/*.deb")


def the_robot_starts(machine, simulator):
    """Its nodes, with System Modes, on the container's loopback."""
    shutil.copy(simulator, machine.path(ROBOT[0]))
    machine.script("cp /usr/share/doc/rips-actuator/examples/smh.yaml /etc/rips/")
    machine.start("robot", *robot("robot"), "--smh", "/etc/rips/smh.yaml")


def agents_start_without_certificates_and_server(machine):
    examples = "/usr/share/doc/rips-sensor/examples"
    machine.script(f"""
sed -e 's/policy.example/127.0.0.1/' -e 's/interface: eth0/interface: lo/' \\
    {examples}/sensor.yaml >/etc/rips/sensor.yaml
""")
    machine.path("/etc/rips/actuator.yaml").write_text(ACTUATOR)
    # `enable --now` returns when they have notified that they are ready.
    machine.script("systemctl enable --now rips-sensor rips-actuator")
    machine.script("systemctl is-active rips-exec.socket rips-fw.socket")  # the actuator wants them
    for unit in ("rips-sensor", "rips-actuator"):
        machine.await_status(unit, "not connected")
        check(machine.show(unit, "NRestarts") == "0", machine.status(unit))


def the_server_is_active_when_it_serves(machine):
    machine.script("""
mint="rips-mint --dir fleet --trust-domain fleet.example"
$mint init
$mint server ps1
$mint operator admin alice
cp /usr/share/doc/rips-policy-server/examples/*.yaml /etc/rips/
cp -r /usr/share/rips/policies/warehouse /etc/rips/bundles/
install -d -m 0750 -g rips-policy-server /etc/rips/issuing
install -m 0640 -g rips-policy-server fleet/ca/issuing.pem /etc/rips/issuing/cert.pem
install -m 0640 -g rips-policy-server fleet/ca/issuing.key /etc/rips/issuing/key.pem
echo 'enrolment: {cert: /etc/rips/issuing/cert.pem, key: /etc/rips/issuing/key.pem}' \\
    >>/etc/rips/policy-server.yaml
systemctl enable --now --no-block rips-policy-server
""")
    # Without a certificate it waits, and says so; with one it serves.
    unit = "rips-policy-server"
    wait_until(lambda: "certificate" in machine.show(unit, "StatusText"),
               lambda: machine.status(unit))
    check(machine.show(unit, "ActiveState") == "activating", machine.status(unit))
    machine.script("""
install -m 0640 -g rips-policy-server fleet/server/ps1/*.pem /etc/rips/pki/policy-server/
""")
    machine.await_status(unit, r"^serving on \S+:7443; robots judged: 1, without a policy: 0$")


def the_robot_enrols_with_a_token(machine):
    ripsctl = " ".join(RIPSCTL)
    machine.script(f"""
{ripsctl} enrol create-token r1 base --address 127.0.0.1:7443 --out r1.token
rips-enrol fetch --token r1.token
systemctl enable --now rips-enrol-renew.timer
""")
    # They find the certificates by themselves.
    machine.await_status("rips-sensor", "; connected")
    machine.await_status("rips-actuator", held("DEFAULT"))


def the_tap_gives_up_its_capabilities(machine):
    machine.script("sed -i 's/^wire: .enabled: false./wire: {enabled: true}/' /etc/rips/sensor.yaml")
    machine.script("systemctl restart rips-sensor; systemctl enable --now rips-wire")
    check(machine.show("rips-wire", "ActiveState") == "active", machine.status("rips-wire"))
    process = machine.show("rips-wire", "MainPID")
    held = machine.run("grep", "^Cap", f"/proc/{process}/status").stdout
    check(re.findall(r"Cap(?:Inh|Prm|Eff|Amb):\s*(\w+)", held) == ["0" * 16] * 4, held)
    machine.await_status("rips-sensor", "; connected")
    check(machine.show("rips-wire", "NRestarts") == "0", machine.status("rips-wire"))


def an_attack_stops_the_robot(machine):
    machine.start("unknown", *robot("intruder"), "--mode", "unknown-node")
    machine.await_status("rips-actuator", held("ALERT"))
    machine.start("driver", *robot("intruder"), "--mode", "rogue-cmd-vel", "--node", "/driver")
    machine.await_status("rips-actuator", held("COMPROMISED"))
    machine.run("systemctl", "stop", "driver", "unknown")


def a_reload_ends(machine):
    machine.run("systemctl", "reload", "rips-policy-server")
    machine.await_status("rips-policy-server", "^serving on ")
    inventory = machine.path("/etc/rips/robots.yaml")
    text = inventory.read_text(encoding="utf-8")
    inventory.write_text("robots: 7\n", encoding="utf-8")
    machine.run("systemctl", "reload", "rips-policy-server")
    machine.await_status("rips-policy-server", "; the inventory on disk is refused$")
    inventory.write_text(text, encoding="utf-8")
    machine.run("systemctl", "reload", "rips-policy-server")
    machine.await_status("rips-policy-server", "without a policy: 0$")


def a_hung_sensor_is_started_anew(machine):
    unit = "rips-sensor.service"
    drop_in = machine.path(f"/etc/systemd/system/{unit}.d/test.conf")
    drop_in.parent.mkdir()
    drop_in.write_text("[Service]\nWatchdogSec=4\n")
    machine.script(f"systemctl daemon-reload; systemctl restart {unit}")
    machine.await_status(unit, "; connected")
    # Longer than the period: who works is not ended.
    time.sleep(6)
    first = machine.show(unit, "MainPID")
    check(machine.show(unit, "NRestarts") == "0", machine.status(unit))
    machine.run("kill", "-STOP", first)
    wait_until(lambda: machine.show(unit, "NRestarts") == "1", lambda: machine.status(unit))
    machine.await_status(unit, "; connected")
    check(machine.show(unit, "MainPID") != first, machine.status(unit))
    said = machine.run("journalctl", "--no-pager", "-u", unit).stdout
    check("Watchdog timeout" in said, said)


def an_upgrade_keeps_the_level(machine, packages):
    before = {unit: machine.show(unit, "MainPID") for unit in DAEMONS}
    install(machine, packages)
    machine.await_status("rips-policy-server", "^serving on ")
    machine.await_status("rips-actuator", held("COMPROMISED"))
    machine.await_status("rips-sensor", "; connected")
    same = [unit for unit in DAEMONS if machine.show(unit, "MainPID") == before[unit]]
    check(not same, f"{same} were not restarted by the upgrade")


def the_operator_brings_the_robot_back(machine):
    machine.run(*RIPSCTL, "level", "lower", "r1", "--to", "ALERT", "--reason", "seen on site")
    # The rest of the way is a rule's, once all is quiet.
    machine.await_status("rips-actuator", held("DEFAULT"))
    told = json.loads(machine.run(*RIPSCTL, "--output", "json", "level", "history", "r1").stdout)
    levels = [each["to"] for each in told["transitions"] if not each["refused"]]
    check(levels[:4] == ["DEFAULT", "ALERT", "COMPROMISED", "ALERT"],
          f"the history, newest first, is {levels}")


def a_removal_leaves_no_process(machine, packages):
    names = [package.name.partition("_")[0] for package in packages]
    machine.run("dpkg", "--remove", *names)
    left = machine.run("pgrep", "-af", "^/usr/bin/rips-", ok=False).stdout
    check(not left, f"the removal leaves {left}")


def inside(place, simulator, packages):
    cgroup = Cgroup()
    machine = None
    began = time.monotonic()

    def step(what, *arguments):
        nonlocal began
        what(machine, *arguments)
        print(f"passed {what.__name__} in {time.monotonic() - began:.1f} s", flush=True)
        began = time.monotonic()

    try:
        machine = Machine(place)
        print(f"booted in {time.monotonic() - began:.1f} s", flush=True)
        began = time.monotonic()
        step(install, packages)
        step(the_robot_starts, simulator)
        step(agents_start_without_certificates_and_server)
        step(the_server_is_active_when_it_serves)
        step(the_robot_enrols_with_a_token)
        step(the_tap_gives_up_its_capabilities)
        step(an_attack_stops_the_robot)
        step(a_reload_ends)
        step(a_hung_sensor_is_started_anew)
        step(an_upgrade_keeps_the_level, packages)
        step(the_operator_brings_the_robot_back)
        step(a_removal_leaves_no_process, packages)
    finally:
        if machine is not None:
            machine.stop()
        cgroup.remove()


def main():
    os.umask(0o022)
    if sys.argv[1] == "--inside":
        try:
            place, simulator, *packages = map(pathlib.Path, sys.argv[2:])
            inside(place, simulator, packages)
        except Skipped as skipped:
            print(f"skipped boot: {skipped}")
            return 77
        except (Failed, OSError, subprocess.TimeoutExpired) as failed:
            print(f"FAILED: {failed}")
            return 1
        return 0
    for program in ("systemd-nspawn", "dpkg-shlibdeps", "patchelf", "nsenter"):
        if not shutil.which(program):
            print(f"skipped boot: {program} is missing")
            return 77
    if os.geteuid() != 0 or run(*UNSHARE, "true", ok=False).returncode != 0:
        print("skipped boot: only root can boot a container, where namespaces are allowed")
        return 77
    with tempfile.TemporaryDirectory(prefix="rips-boot-test-") as directory:
        place = pathlib.Path(directory) / "machine"
        place.mkdir()
        build = pathlib.Path(sys.argv[1]).resolve()
        try:
            packages = make_packages(build, pathlib.Path(directory) / "packages", QUICK)
        except NotMade as why:
            print(f"FAILED to make the packages: {why}")
            return 1
        return subprocess.run([*UNSHARE, sys.executable, "-B", __file__, "--inside", place,
                               build / "bin/robot_sim", *packages], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
