"""Certificates, clocks and ports that are not what they should be when daemons start, or later: real
processes. Nothing of this may end a daemon, lower a level or go unsaid.

    certificates_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import pathlib
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import SOURCE, Fleet, check, eventually, metrics, perform  # noqa: E402

DAY = 24 * 3600
FAKETIME = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1"


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def told(process, text):
    return [line for _, line in process.lines if text in line]


def try_page(port, path):
    """(status, body) of a daemon's page; None while it is not served."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=10) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()
    except OSError:
        return None


def page(port, path):
    return eventually(lambda: try_page(port, path), 15, f"a page at port {port}")


class LateFleet(Fleet):
    """Each daemon has a metrics port that is known beforehand, and is started without waiting."""

    def plan(self):
        self.port = free_port()
        self.pages = {name: free_port() for name in ("policy-server", "sensor", "actuator")}

    def set_clock(self, seconds):
        """How far the wall clock of the robot is away, from now on."""
        new = self.dir / "clock.new"
        new.write_text(f"{seconds:+d}\n")
        new.rename(self.dir / "clock")

    def start_on_robot(self, name):
        """As start_late, with the robot's wall clock."""
        return self.start_late(name, "env", f"LD_PRELOAD={FAKETIME}", "FAKETIME_NO_CACHE=1",
                               f"FAKETIME_TIMESTAMP_FILE={self.dir}/clock",
                               "FAKETIME_DONT_FAKE_MONOTONIC=1")

    def start_late(self, name, *before):
        if name == "policy-server":
            self.write_server_config(self.port)
        else:
            self.write_agent_configs()
        # A file of its own: the others' are written anew with each start.
        config = self.write(f"{name}.late.yaml", (self.dir / f"{name}.yaml").read_text().replace(
            'metrics: "127.0.0.1:0"', f'metrics: "127.0.0.1:{self.pages[name]}"'))
        return self.start(name, *before, self.bin / f"rips-{name}", "--config", config, "--ready-file",
                          self.dir / f"{name}.ready")

    def start_all_late(self):
        self.robot = self.start_robot()
        self.actuator = self.start_late("actuator")
        self.server = self.start_late("policy-server")
        self.sensor = self.start_late("sensor")

    def wait_level(self, level, seconds, **options):
        eventually((self.dir / "policy-server.ready").exists, 20, "the server is ready")
        return super().wait_level(level, seconds, **options)

    def mint_at(self, seconds, *args):
        """As if the clock were so many seconds away."""
        subprocess.run(["faketime", "-f", f"{seconds:+d}s", SOURCE / "deploy/pki/mint", "--dir",
                        self.dir / "pki", "--trust-domain", "fleet.example", *args], check=True,
                       stdout=subprocess.DEVNULL)

    def expect_waiting(self, reason):
        """Nobody has ended; each says what it waits for, once; the robot is safe meanwhile."""
        daemons = (self.server, self.sensor, self.actuator)
        for process in daemons:
            process.wait_for(lambda line: "waiting for a usable certificate" in line and
                             reason in line, 15, f"{process.name} says what it waits for")
        eventually(lambda: self.mode()["mode"] == self.fail_safe, 20,
                   "the robot is brought to its fail-safe level")
        for process in daemons:
            check(process.running, f"{process.name} has ended")
            said = told(process, "waiting for a usable certificate")
            check(len(said) == 1, f"{process.name} says it {len(said)} times")
            status, body = page(self.pages[process.name], "/readyz")
            check(status == 503, f"{process.name} is ready: {body}")
        status, body = page(self.pages["policy-server"], "/readyz")
        check("waiting for a usable certificate" in body, body)
        # The server serves nobody; the agents do what they can do alone.
        check(not (self.dir / "policy-server.ready").exists(), "the server calls itself ready")
        for name in ("sensor", "actuator"):
            check((self.dir / f"{name}.ready").exists(), f"the {name} does not say that it is up")


# ------------------------------------------------------------------------------------ scenarios


def keys_that_come_late(fleet):
    fleet.plan()
    fleet.prepare()
    keys = {}
    for role in ("server/ps1", "sensor/r1/base", "actuator/r1/base"):
        key = (fleet.dir / "pki" / role / "key.pem").resolve()
        keys[key] = key.read_bytes()
        key.unlink()
    fleet.start_all_late()
    fleet.expect_waiting("key.pem")

    for key, content in keys.items():
        key.touch(0o600)
        key.write_bytes(content[:len(content) // 2])  # half of it is no reason to end either
    time.sleep(1)
    for key, content in keys.items():
        key.write_bytes(content)

    eventually((fleet.dir / "policy-server.ready").exists, 20, "the server is ready")
    fleet.wait_level("DEFAULT", 40)
    for name, port in fleet.pages.items():
        eventually(lambda at=port: page(at, "/readyz")[0] == 200, 20, f"{name} is ready")
        text = page(port, "/metrics")[1]
        check('rips_certificate_expiry_seconds{' in text and 'whose="own"' in text,
              f"{name} does not tell how long its certificate lasts")
    text = page(fleet.pages["actuator"], "/metrics")[1]
    check('name="ps1",role="policy-server",whose="peer"' in text, "nor how long the server's does")


def certificates_that_are_not_valid_yet(fleet):
    """As on a board without a clock of its own, until it has the time."""
    fleet.plan()
    ahead = 25
    # The operator's before the server's: each begins when it was made, and ripsctl does not wait.
    for args in (("init",), ("operator", "operator", "alice"), ("server", "ps1"),
                 ("sensor", "r1", "base"), ("actuator", "r1", "base")):
        fleet.mint_at(ahead, *args)
    begin = time.monotonic() + ahead
    fleet.prepare()
    fleet.start_all_late()
    fleet.expect_waiting("not yet valid")

    check(time.monotonic() < begin, "the certificates were valid before they were looked at")
    eventually((fleet.dir / "policy-server.ready").exists, ahead + 20, "the server is ready")
    fleet.wait_level("DEFAULT", 40)


def the_robot_boots_in_1970(fleet):
    """A board without a clock of its own, which has the time when NTP has it; and loses it again, as
    after a manual change. The server, on another host, has it throughout."""
    fleet.plan()
    fleet.prepare()
    in_1970 = DAY - int(time.time())
    fleet.set_clock(in_1970)
    fleet.robot = fleet.start_robot()
    fleet.server = fleet.start_late("policy-server")
    eventually((fleet.dir / "policy-server.ready").exists, 20, "the server is ready")
    fleet.actuator = fleet.start_on_robot("actuator")
    fleet.sensor = fleet.start_on_robot("sensor")
    for agent in (fleet.actuator, fleet.sensor):
        agent.wait_for(lambda line: "not yet valid" in line and "clock" in line, 20,
                       f"{agent.name} says that the clock may be wrong")
    eventually(lambda: fleet.mode()["mode"] == fleet.fail_safe, 30, "the robot is safe meanwhile")
    check(fleet.level()["decided_level"] == "DEFAULT", "a wrong clock raised the robot")

    fleet.set_clock(0)

    fleet.wait_level("DEFAULT", 40)
    eventually(lambda: fleet.mode()["mode"] == "__DEFAULT__", 20, "the robot is as decided")
    check("rogue" not in str(fleet.history()), f"it looked like an attack: {fleet.history()}")

    fleet.set_clock(in_1970)

    # Leases and order know nothing of it, and a stream that is open stays: it is said, no more.
    eventually(lambda: any("clock" in alert["text"] for alert in fleet.alerts()), 20,
               "the server says that the sensor's clock is off")
    end = time.monotonic() + 10
    while time.monotonic() < end:
        check(fleet.mode()["mode"] == "__DEFAULT__", "a clock that was set stopped the robot")
        time.sleep(1)
    for agent in (fleet.actuator, fleet.sensor):
        check(agent.running, f"{agent.name} has ended")

    fleet.set_clock(0)
    fleet.wait_level("DEFAULT", 20)
    lost = [alert["text"] for alert in fleet.alerts() if "were lost" in alert["text"]]
    check(not lost, f"events were lost: {lost}")


def the_servers_certificate_expires(fleet):
    """Agents cut it, robots are brought to their own floor, the server is not ready and says so; and
    a renewal mends all of it without a restart."""
    fleet.plan()
    left = 25
    fleet.mint_at(left - DAY, "--days", "1", "init")
    fleet.prepare()
    fleet.mint_at(left - DAY, "--days", "1", "--renew", "server", "ps1")
    end = time.monotonic() + left
    fleet.start_all_late()
    fleet.wait_level("DEFAULT", 20)
    check(page(fleet.pages["policy-server"], "/readyz")[0] == 200, "the server is not ready")

    for agent in (fleet.sensor, fleet.actuator):
        agent.wait_for(lambda line: "the policy server: the certificate has expired" in line,
                       max(1.0, end - time.monotonic()) + 10, f"{agent.name} cuts the stream")
    check(time.monotonic() < end + 6, "it was cut late")
    _, body = eventually(lambda: (lambda answer: answer[0] == 503 and answer)(
        page(fleet.pages["policy-server"], "/readyz")), 3, "the server is not ready any more")
    check("expired" in body, body)
    eventually(lambda: fleet.mode()["mode"] == fleet.fail_safe, 30, "the lease runs out")
    check(fleet.server.running, "the server has ended")

    fleet.mint("--renew", "server", "ps1")

    eventually(lambda: page(fleet.pages["policy-server"], "/readyz")[0] == 200, 10,
               "the renewed certificate is read")
    eventually(lambda: len(told(fleet.sensor, " streaming ")) == 2, 20, "the sensor is back")
    fleet.wait_level("DEFAULT", 40)
    own = [alert["text"] for alert in fleet.query("alert", "list", "--limit", "1000")["alerts"]
           if alert["robot"] == "(server)"]
    check(sum("own certificate" in text and "has expired" in text for text in own) == 1,
          f"the expiry is told in {own}")
    check(sum("less than a tenth" in text for text in own) == 1, f"the last tenth is told in {own}")


def an_agents_certificate_expires(fleet):
    """Alerts before, the stream is cut at its end although the file was renewed long before, and the
    agent is back at once with the new one: nobody is lost for it."""
    fleet.plan()
    left = 25
    fleet.mint_at(left - DAY, "--days", "1", "init")
    fleet.prepare()
    fleet.mint_at(left - DAY, "--days", "1", "--renew", "actuator", "r1", "base")
    fleet.start_all_late()
    fleet.wait_level("DEFAULT", 20)
    connected = len(told(fleet.actuator, " connected"))

    fleet.mint("--renew", "actuator", "r1", "base")

    _, line = fleet.server.wait_for(
        lambda text: " refused " in text and "reason=expired" in text and text, left + 10,
        "the old stream is cut")
    check("/robot/r1/actuator/base" in line, line)
    eventually(lambda: len(told(fleet.actuator, " connected")) > connected, 10,
               "the actuator is back with the new one")
    fleet.wait_level("DEFAULT", 20)
    texts = [alert["text"] for alert in fleet.alerts()]
    check(sum("actuator/base" in text and "less than a tenth" in text for text in texts) == 1,
          f"told in {texts}")
    check(not any("actuator base is lost" in text for text in texts), f"it was lost: {texts}")
    counted = metrics(fleet.server)
    check(counted["rips_refused_calls_total"] >= 1, "it is not counted")


def metrics_ports_that_are_taken(fleet):
    fleet.plan()
    others = []
    for port in fleet.pages.values():
        other = socket.socket()
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        other.bind(("127.0.0.1", port))
        other.listen()
        others.append(other)
    fleet.prepare()
    fleet.start_all_late()

    fleet.wait_level("DEFAULT", 40)
    for process in (fleet.server, fleet.sensor, fleet.actuator):
        check(told(process, "cannot serve metrics"), f"{process.name} does not say so")
    alerts = fleet.query("alert", "list", "--limit", "1000")["alerts"]
    check(any(alert["robot"] == "(server)" and alert["severity"] == "critical" and
              "cannot serve metrics" in alert["text"] for alert in alerts), f"{alerts}")

    for other in others:
        other.close()
    for name, port in fleet.pages.items():
        _, text = eventually(lambda at=port: try_page(at, "/metrics"), 45,
                             f"{name} serves its metrics")
        check("\nrips_metrics_bind_failures_total " in text, f"{name} has not counted it")


def the_modes_keystore_comes_late(fleet):
    """Without a way to the System Modes, the other steps of the fail-safe level are taken; with one,
    all."""
    from security_test import ROBOT, Keystore
    fleet.plan()
    keys = Keystore(fleet.dir / "keystore")
    for enclave, kind in ROBOT.items():
        keys.mint(enclave, *kind)
    looker = keys.mint("/looker", "actuator")
    fleet.keystore = keys.dir
    mark = fleet.dir / "alarm"
    fleet.steps = {"ALERT": [f'{{program: {{name: mark, args: ["{mark}"]}}, timeout: 2s}}']}
    fleet.programs = "programs:\n  - {name: mark, path: /usr/bin/touch}\n"
    # Steps are taken in order, and a failed one ends them unless it says otherwise.
    fleet.prepare()
    fleet.robot = fleet.start_robot("--keystore", keys.dir)
    hidden = fleet.dir / "keystore-elsewhere"
    keys.dir.rename(hidden)
    fleet.write_agent_configs()
    config = fleet.dir / "actuator.yaml"
    fleet.start_exec()
    original = fleet.write_agent_configs

    def write_continuing():
        original()
        config.write_text(config.read_text().replace(
            "timeout: 4s, retries: 2}", "timeout: 4s, retries: 2, on_failure: continue}"))
    fleet.write_agent_configs = write_continuing
    fleet.actuator = fleet.start_late("actuator")

    eventually(mark.exists, 20, "the alarm of the fail-safe level")
    check(fleet.actuator.running, "the actuator has ended")
    check(told(fleet.actuator, "System Modes unreachable"), "it does not say so")
    status, body = page(fleet.pages["actuator"], "/readyz")
    check(status == 503 and "keystore" in body, f"{status} {body}")

    hidden.rename(keys.dir)

    eventually(lambda: fleet.mode(*looker)["mode"] == fleet.fail_safe, 40,
               "the modes follow when there is a way")


SCENARIOS = [keys_that_come_late, certificates_that_are_not_valid_yet, the_robot_boots_in_1970,
             the_servers_certificate_expires, an_agents_certificate_expires,
             metrics_ports_that_are_taken, the_modes_keystore_comes_late]


def main():
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    scenario = next(each for each in SCENARIOS if each.__name__ == sys.argv[2])
    if shutil.which("faketime") is None:
        print(f"skipped {scenario.__name__}: no faketime")
        return 77
    parent = pathlib.Path(sys.argv[1]).resolve().parent / "scenarios"
    parent.mkdir(exist_ok=True)
    directory = pathlib.Path(tempfile.mkdtemp(prefix=scenario.__name__ + ".", dir=parent))
    code = perform(scenario.__name__, scenario,
                   LateFleet(sys.argv[1], directory, floor_hold="1s"))
    if code == 0:
        shutil.rmtree(directory)
    return code


if __name__ == "__main__":
    sys.exit(main())
