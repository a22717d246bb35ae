"""One robot and its RIPS on this machine, from the real binaries: for the demo and for tests.

Every process listens on a free port of the loopback interface, has its files in one directory and
its DDS domain to itself, and is ended by pid.
"""

import datetime
import json
import os
import pathlib
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

SOURCE = pathlib.Path(__file__).resolve().parents[2]
LEVELS = ["DEFAULT", "ALERT", "COMPROMISED", "HALT"]
MODES = {"DEFAULT": "__DEFAULT__"}


class Failed(Exception):
    """A step did not come out as it must; the text says how."""


class Skipped(Exception):
    """The scenario cannot be played here; the text says why."""


def check(holds, what):
    if not holds:
        raise Failed(what)


def perform(name, scenario, world, tail=25):
    """Plays a scenario in its world and stops what it started. Returns the exit code for ctest: 0,
    1 if it failed, after the newest `tail` lines of each process, or 77 if it was skipped."""
    try:
        scenario(world)
    except Skipped as skipped:
        print(f"skipped {name}: {skipped}")
        return 77
    except Failed as failed:
        for process in world.processes:
            print(f"--- {process.name}")
            print("\n".join(text for _, text in process.lines[-tail:]))
        print(f"FAILED {name}: {failed}")
        return 1
    finally:
        world.stop()
    print(f"passed {name}")
    return 0


def play(scenarios, kind):
    """Plays the scenario that the command line names (BINARIES SCENARIO) with a fleet of that kind,
    in a directory that is removed unless it fails; prints the names of all if it names none.
    Returns the exit code."""
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in scenarios))
        return 0
    scenario = next(each for each in scenarios if each.__name__ == sys.argv[2])
    parent = pathlib.Path(sys.argv[1]).resolve().parent / "scenarios"
    parent.mkdir(exist_ok=True)
    directory = pathlib.Path(tempfile.mkdtemp(prefix=scenario.__name__ + ".", dir=parent))
    directory.chmod(0o755)  # plugins and others run as other users
    code = perform(scenario.__name__, scenario, kind(sys.argv[1], directory))
    if code != 1:
        shutil.rmtree(directory)
    return code


def unix_ns(time_text):
    """RFC 3339 in UTC, any number of decimals, to nanoseconds since the Unix epoch."""
    whole, _, fraction = time_text.rstrip("Z").partition(".")
    base = datetime.datetime.strptime(whole, "%Y-%m-%dT%H:%M:%S").replace(
        tzinfo=datetime.timezone.utc)
    return int(base.timestamp()) * 10**9 + int((fraction + "0" * 9)[:9])


class Process:
    """A child process. Its lines are kept, with the time they came, and written to NAME.log."""

    def __init__(self, name, args, directory, env=None):
        self.name = name
        self.lines = []  # (monotonic seconds, text)
        self._changed = threading.Condition()
        self._log = open(pathlib.Path(directory) / f"{name}.log", "ab", buffering=0)
        self.child = subprocess.Popen(
            [str(arg) for arg in args], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, env=env, start_new_session=True)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        for raw in self.child.stdout:
            self._log.write(raw)
            with self._changed:
                self.lines.append((time.monotonic(), raw.decode("utf-8", "replace").rstrip("\n")))
                self._changed.notify_all()

    @property
    def running(self):
        return self.child.poll() is None

    def events(self):
        """The lines that are JSON objects."""
        with self._changed:
            texts = [text for _, text in self.lines if text.startswith("{")]
        return [json.loads(text) for text in texts]

    def wait_for(self, found, seconds, what, start=0):
        """The first line from `start` on for which found(text) is true, as (index, its value)."""
        deadline = time.monotonic() + seconds
        index = start
        with self._changed:
            while True:
                while index < len(self.lines):
                    value = found(self.lines[index][1])
                    if value:
                        return index, value
                    index += 1
                left = deadline - time.monotonic()
                if left <= 0:
                    raise Failed(f"{what}: not within {seconds:g} s; see {self._log.name}")
                if not self.running and not self._reader.is_alive():
                    raise Failed(f"{what}: {self.name} ended with code {self.child.returncode}; "
                                 f"see {self._log.name}")
                self._changed.wait(min(left, 0.2))

    def kill(self, sig=signal.SIGTERM, seconds=10):
        if self.running:
            os.kill(self.child.pid, sig)
        try:
            self.child.wait(seconds)
        except subprocess.TimeoutExpired:
            os.kill(self.child.pid, signal.SIGKILL)
            self.child.wait(seconds)
            if sig != signal.SIGKILL:
                raise Failed(f"{self.name} did not end within {seconds} s of signal {sig}") from None
        self._reader.join(2)
        return self.child.returncode


def dds_uri(interface, tag):
    """CYCLONEDDS_URI for processes that use that interface alone, and find only those of the same
    tag."""
    return (f"<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"{interface}\" "
            f"multicast=\"true\"/></Interfaces></General><Discovery><Tag>{tag}</Tag>"
            "<ParticipantIndex>none</ParticipantIndex></Discovery></Domain></CycloneDDS>")


class Fleet:
    """A robot's host, and the policy server that watches and commands it: robot `r1`, host `base`,
    all on loopback, unless a subclass says otherwise."""

    robot_id, host_name = "r1", "base"
    address = "127.0.0.1"  # where the policy server listens
    interface = "lo"  # of DDS

    def __init__(self, binaries, directory, bundle="warehouse", fail_safe="ALERT",
                 floor_hold="10s", programs=""):
        self.bin = pathlib.Path(binaries).resolve()
        self.bin_of = {}  # program -> directory, of those that are not in `bin`
        self.dir = pathlib.Path(directory).resolve()
        self.dir.mkdir(parents=True, exist_ok=True)
        # Ports of domains above 100 lie where Linux gives ports to others (DDSI-RTPS 2.5 §9.6.2.3).
        self.domain = random.randint(10, 99)
        self.bundle = bundle
        self.fail_safe = fail_safe
        self.floor_hold = floor_hold
        self.programs = programs  # YAML list of actuator.yaml
        self.mode_options = ""  # more of `system_modes`, each after a comma
        self.steps = {}  # further enter steps of a level, each a YAML list item in one line
        self.probed = "/camera/image_raw"  # what a probe, which is no node, may read
        self.sensor_options = ""  # more lines of sensor.yaml
        self.within = []  # what each command begins with, such as `ip netns exec NAME`
        self.keystore = None  # with DDS Security: the enclaves /rips/sensor and /rips/actuator
        self.processes = []
        self.calls = self.called = 0  # of ripsctl, and when
        self.exec = None
        self.port = None
        self.smh = SOURCE / "tests/support/robot_sim/smh.yaml"
        self.levels = LEVELS  # of the bundle
        # Only loopback, whatever the caller's environment says; and whoever happens to be in the
        # same domain at the same time is neither seen nor sees us.
        self.env = {key: value for key, value in os.environ.items()
                    if not key.startswith("RIPSCTL_")}
        self.env["CYCLONEDDS_URI"] = dds_uri(self.interface, f"fleet-{random.getrandbits(64):016x}")

    # ------------------------------------------------------------------------------- set-up

    def mint(self, *args):
        subprocess.run([SOURCE / "deploy/pki/mint", "--dir", self.dir / "pki", "--trust-domain",
                        "fleet.example", *args], check=True, stdout=subprocess.DEVNULL)

    def tls(self, *path):
        directory = self.dir.joinpath("pki", *path)
        return (f"{{ca: {directory}/ca.pem, cert: {directory}/cert.pem, "
                f"key: {directory}/key.pem}}")

    def write(self, name, text):
        path = self.dir / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    def prepare(self):
        """Certificates, directories and the server's files; the agents' when its port is known."""
        self.mint("init")
        self.mint("server", "ps1")
        self.mint("sensor", "r1", "base")
        self.mint("actuator", "r1", "base")
        self.mint("operator", "operator", "alice")
        for name in ("server", "sensor", "actuator"):
            (self.dir / name).mkdir(exist_ok=True)
        self.write("robots.yaml", f"""robots:
  - {{id: r1, bundle: {self.bundle}, sensors: [{{host: base, primary: true}}], actuators: [base]}}
""")
        self.write_server_config(0)

    def write_server_config(self, port):
        self.write("policy-server.yaml", f"""id: ps1
listen: "{self.address}:{port}"
trust_domain: fleet.example
tls: {self.tls("server", "ps1")}
inventory: {self.dir}/robots.yaml
bundles: {{source: {self.bundles_source()}, dir: {self.dir}/server/bundles}}
store: {{kind: sqlite, path: {self.dir}/server/state.db}}
audit: {{dir: {self.dir}/server/audit}}
alerts: {{file: {self.dir}/server/alerts.jsonl}}
metrics: "127.0.0.1:0"
""")

    def bundles_source(self):
        own = self.dir / "bundles"
        return own if own.exists() else SOURCE / "rules"

    def write_agent_configs(self):
        def common(role):
            security = (f", security: {{keystore: {self.keystore}, enclave: /rips/{role}}}"
                        if self.keystore else "")
            return f"""robot: {self.robot_id}
host: {self.host_name}
servers: ["{self.address}:{self.port}"]
dds: {{domain: {self.domain}, interface: {self.interface}{security}}}
metrics: "127.0.0.1:0"
"""
        tls = {role: self.tls(role, self.robot_id, self.host_name)
               for role in ("sensor", "actuator")}
        self.write("sensor.yaml", common("sensor") + f"""tls: {tls["sensor"]}
state_dir: {self.dir}/sensor
raw_readers: [{self.probed}]
{self.sensor_options}""")
        levels = "".join(
            f"""  - name: {level}
    enter:
      - {{system_mode: {{part: /safety, mode: {MODES.get(level, level)}}}, timeout: 4s, retries: 2}}
{"".join(f"      - {step}{chr(10)}" for step in self.steps.get(level, []))}    leave: []
""" for level in self.levels)
        self.write("actuator.yaml", common("actuator") + f"""tls: {tls["actuator"]}
state_dir: {self.dir}/actuator
fail_safe: {{level: {self.fail_safe}, after: 0s}}
system_modes: {{smh: {self.smh}, verify: parts{self.mode_options}}}
timing: {{floor_hold: {self.floor_hold}}}
exec: {{socket: {self.dir}/exec.sock, user: "{os.geteuid()}"}}
levels:
{levels}{self.programs}""")

    # ---------------------------------------------------------------------------- processes

    def path_of(self, name):
        return pathlib.Path(self.bin_of.get(name, self.bin)) / name

    def start(self, name, *args):
        process = Process(name, [*self.within, *args], self.dir, self.env)
        self.processes.append(process)
        return process

    def robot_sim(self, command):
        """The beginning of a command of robot_sim."""
        return [self.bin / "robot_sim", command, "--domain", str(self.domain), "--interface",
                self.interface]

    def start_robot(self, *options):
        robot = self.start("robot", *self.robot_sim("robot"), "--smh", self.smh, *options)
        robot.wait_for(lambda line: '"event":"ready"' in line, 15, "the robot starts")
        return robot

    def _ready(self, process, path, what):
        deadline = time.monotonic() + 15
        while not path.exists() or not path.read_text().strip():
            if not process.running:
                last = process.lines[-1][1] if process.lines else "it printed nothing"
                raise Failed(f"{what} ended with code {process.child.returncode}: {last}")
            if time.monotonic() > deadline:
                raise Failed(f"{what} is not ready after 15 s; see {self.dir}/{process.name}.log")
            time.sleep(0.02)
        return path.read_text().strip()

    def start_server(self):
        """Starts the policy server; again on the port it had."""
        ready = self.dir / "server/ready"
        ready.unlink(missing_ok=True)
        if self.port is not None:
            self.write_server_config(self.port)
        server = self.start("policy-server", self.path_of("rips-policy-server"), "--config",
                            self.dir / "policy-server.yaml", "--ready-file", ready)
        address = self._ready(server, ready, "the policy server")
        self.port = int(address.rsplit(":", 1)[1])
        return server

    def start_agent(self, role, wait=True):
        self.write_agent_configs()
        if role == "actuator" and self.programs:
            self.start_exec()
        ready = self.dir / role / "ready"
        ready.unlink(missing_ok=True)
        everybodys, self.env = self.env, dict(self.env)
        if role == "sensor" and "CYCLONEDDS_URI" in self.env:  # as it is without
            self.env["CYCLONEDDS_URI"] = self.env["CYCLONEDDS_URI"].replace(
                "</General>", "<AllowMulticast>spdp</AllowMulticast></General>")
        agent = self.start(role, self.path_of(f"rips-{role}"), "--config",
                           self.dir / f"{role}.yaml", "--ready-file", ready)
        self.env = everybodys
        if wait:
            self._ready(agent, ready, f"the {role}")
        return agent

    def start_exec(self):
        """rips-exec, unless it runs already."""
        if self.exec is None or not self.exec.running:
            ready = self.dir / "exec.ready"
            ready.unlink(missing_ok=True)
            self.exec = self.start("exec", self.path_of("rips-exec"), "--config",
                                   self.dir / "actuator.yaml", "--ready-file", ready)
            self._ready(self.exec, ready, "rips-exec")
        return self.exec

    def start_intruder(self, mode, *options):
        return self.start("intruder", *self.robot_sim("intruder"), "--mode", mode, *options)

    def start_publisher(self, *options):
        """A node `/load` that publishes on `/load`, from when somebody reads."""
        return self.start("load", *self.robot_sim("publish"), *options)

    def start_camera_probe(self):
        return self.start("camera", *self.robot_sim("probe"), "--window-ms", "1000")

    def stop(self):
        for process in reversed(self.processes):
            try:
                process.kill()
            except Failed as failed:
                print(f"warning: {failed}", file=sys.stderr)
        self.processes = []

    # ------------------------------------------------------------------------------ ripsctl

    def ripsctl_args(self, *args, who="operator/alice"):
        pki = self.dir / "pki/operator" / who
        return [*self.within, str(self.path_of("ripsctl")), "--server",
                f"{self.address}:{self.port}", "--ca", f"{pki}/ca.pem", "--cert",
                f"{pki}/cert.pem", "--key", f"{pki}/key.pem", *map(str, args)]

    def ripsctl(self, *args, check=True, who="operator/alice"):
        """Runs ripsctl as `who`, ROLE/NAME; gives (exit code, stdout, stderr). No faster than the
        server lets a certificate ask, 40 questions and 20 a second."""
        now = time.monotonic()
        self.calls = max(0, self.calls - 18 * (now - self.called)) + 1
        self.called = now
        if self.calls > 30:
            time.sleep(1 / 18)
        done = self.run_ripsctl(self.ripsctl_args(*args, who=who))
        if check and done.returncode != 0:
            raise Failed(f"ripsctl {' '.join(map(str, args))} ended with code {done.returncode}: "
                         f"{done.stderr.strip()}")
        return done.returncode, done.stdout, done.stderr

    def run_ripsctl(self, command, timeout=30):
        """Runs a command of ripsctl, which calls the server several times; again while it is
        refused for asking too often: then nothing was done."""
        deadline = time.monotonic() + timeout
        while True:
            done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                                  timeout=timeout, env=self.env)
            if "calls a second; try again later" not in done.stderr or time.monotonic() > deadline:
                return done
            time.sleep(0.25)

    def rips_enrol(self, folder, *args):
        """Runs rips-enrol for the agents whose certificates are below `folder`."""
        return subprocess.run(
            [*self.within, self.path_of("rips-enrol"), *args, "--dir", folder],
            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60, env=self.env)

    def query(self, *args, **options):
        """The JSON answer of a ripsctl command."""
        return json.loads(self.ripsctl("--output", "json", *args, **options)[1])

    def level(self):
        """The robot's status: decided_level, effective_level, stage, decision, degraded."""
        return self.query("level", "show", self.robot_id)["status"]

    def history(self):
        """Decisions and refusals, oldest first."""
        return self.query("level", "history", self.robot_id, "--limit",
                          "1000")["transitions"][::-1]

    def alerts(self):
        """Alerts, oldest first."""
        return self.query("alert", "list", self.robot_id, "--limit", "1000")["alerts"][::-1]

    def replay(self, alert, name="alert.rips"):
        """Fetches the recording of that alert and runs the robot's rules on it; gives the result of
        `rules replay` and the recording's file."""
        path = self.dir / name
        self.ripsctl("alert", "recording", alert["id"], "--out", str(path), "--force")
        return self.query("rules", "replay", "--rules",
                          str(pathlib.Path(self.bundles_source()) / self.bundle),
                          "--events", str(path)), path

    def wait_level(self, level, seconds, stage="verified", effective=None):
        """Waits until `level` is decided, has reached `stage`, and the robot is held at
        `effective` (the same level unless said otherwise)."""
        deadline = time.monotonic() + seconds
        effective = effective or level
        while True:
            status = self.level()
            if (status["decided_level"], status["stage"], status["effective_level"]) == (
                    level, stage, effective):
                return status
            if time.monotonic() > deadline:
                raise Failed(f"the robot is not at {level} ({stage}) after {seconds:g} s, but at "
                             f"{status['decided_level']} ({status['stage']}), held at "
                             f"{status['effective_level']}; {'; '.join(status['degraded'])}")
            time.sleep(0.1)

    def mode(self, *options):
        """The System Mode read back from the robot, with the state of each part."""
        done = subprocess.run(
            [*self.within, *self.robot_sim("mode"), "--smh", self.smh, *options],
            capture_output=True, text=True, timeout=30, env=self.env)
        for line in done.stdout.splitlines():
            event = json.loads(line)
            if event.get("event") == "mode_of":
                return event
        raise Failed(f"the mode could not be read back: {done.stderr.strip()}")

    def arm(self, *robot_options, seconds=40):
        """Robot, server, sensor and actuator, up to DEFAULT verified and no floor."""
        self.prepare()
        self.robot = self.start_robot(*robot_options)
        self.server = self.start_server()
        self.sensor = self.start_agent("sensor")
        self.actuator = self.start_agent("actuator")
        return self.wait_level("DEFAULT", seconds)


def eventually(condition, seconds, what, every=0.1):
    """The first true value of condition(), asked every so many seconds; Failed with `what` if there
    is none in time."""
    deadline = time.monotonic() + seconds
    while True:
        value = condition()
        if value:
            return value
        check(time.monotonic() < deadline, f"{what}: not within {seconds} s")
        time.sleep(every)


def page(process, path):
    """What a daemon serves at `path` of its metrics address, as text."""
    _, address = process.wait_for(
        lambda line: re.search(r" listening .*?(?:metrics|address)=(127\.0\.0\.1:\d+)$", line), 15,
        f"{process.name} listens")
    with urllib.request.urlopen(f"http://{address.group(1)}/{path}", timeout=10) as reply:
        return reply.read().decode()


def metrics(process):
    """The metrics page of a daemon: name to value, the values of all labels added up."""
    values = {}
    for line in page(process, "metrics").splitlines():
        if not line.startswith("#"):
            name, _, value = line.rpartition(" ")
            name = name.partition("{")[0]
            values[name] = values.get(name, 0.0) + float(value)
    return values


def cpu_seconds(process):
    """What a running process has used of its processors so far."""
    fields = pathlib.Path(f"/proc/{process.child.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


LOG_LINE = re.compile(r"^(\d{4}-\d\d-\d\dT[\d:.]+Z) (\w+) (.*)$")


def log_time(text):
    """Unix time in ns of a daemon's log line, or None."""
    match = LOG_LINE.match(text)
    return unix_ns(match.group(1)) if match else None
