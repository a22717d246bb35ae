"""Attacks on the policy server's port, as scenarios against real processes.

    redteam_test.py                     names of the scenarios that tests/run runs
    redteam_test.py --all               names of all of them
    redteam_test.py BINARIES SCENARIO   runs one, for RIPS_ATTACK_S seconds (6)

Each runs beside a robot under guard, which must not notice: its lease lives, nothing is lost, an
operator is served within 2 s during and after, the server's memory stays under 1 GiB, and an alert
names the attacker where there is one to name. The attacker has an address of its own, and at most a
viewer's certificate.
"""

import os
import pathlib
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
import http2  # noqa: E402
from fleet import Failed, Fleet, metrics  # noqa: E402

ATTACK_S = float(os.environ.get("RIPS_ATTACK_S", "6"))
MEMORY_KIB = 1 << 20
SERVED_S = 2
LIST_ROBOTS = b"/rips.v1.OperatorService/ListRobots"
SCENARIOS = {}
QUICK = []


def scenario(function):
    SCENARIOS[function.__name__] = function
    return function


def quick(function):
    """One that tests/run runs."""
    QUICK.append(function.__name__)
    return scenario(function)


def check(condition, text):
    if not condition:
        raise Failed(text)


def resident_kib(pid):
    for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1])
    raise Failed("the server is gone")


class Guarded(Fleet):
    """A robot under guard, and what it and its operator feel of an attack."""

    def arm(self, *limits):
        self.prepare()
        self.mint("operator", "viewer", "mallory")
        self.robot = self.start_robot()
        self.within = list(limits)
        self.server = self.start_server()
        self.within = []
        self.sensor = self.start_agent("sensor")
        self.actuator = self.start_agent("actuator")
        self.wait_level("DEFAULT", 60)
        self.slowest = 0
        self.began = time.time()

    def key(self):
        return self.dir / "pki/operator/viewer/mallory"

    def attacker(self, source="127.0.0.2"):
        return http2.Client(self.port, self.key(), source)

    def serve_once(self):
        """An operator asks, as one who connects anew."""
        start = time.monotonic()
        self.ripsctl("level", "show", "r1")
        self.slowest = max(self.slowest, time.monotonic() - start)

    def ready(self):
        _, address = self.server.wait_for(
            lambda line: line.partition("metrics=")[2].split(" ")[0], 5, "the page's address")
        try:
            with urllib.request.urlopen(f"http://{address}/readyz", timeout=10) as page:
                return page.status
        except urllib.error.HTTPError as error:
            return error.code

    def run_beside(self, attack):
        """Runs attack() in a thread; an operator asks all the time."""
        trouble = []

        def go():
            try:
                attack()
            except Exception as error:  # noqa: BLE001
                trouble.append(error)

        thread = threading.Thread(target=go, daemon=True)
        thread.start()
        while thread.is_alive():
            self.serve_once()
            time.sleep(0.2)
        if trouble:
            raise trouble[0]

    def unharmed(self):
        for _ in range(3):
            self.serve_once()
        check(self.ready() == 200, "/readyz is not 200 after the attack")
        check(self.slowest <= SERVED_S, f"an operator waited {self.slowest:.1f} s")
        peak = resident_kib(self.server.child.pid)
        check(peak < MEMORY_KIB, f"the server took {peak >> 10} MiB")
        status = self.level()
        check(status["effective_level"] == "DEFAULT" and status["stage"] == "verified",
              f"the robot felt it: {status}")
        lost = [line for _, line in self.actuator.lines if "lease expired" in line]
        check(not lost, f"the actuator lost its lease: {lost}")
        told = [a["text"] for a in self.alerts()]
        harm = [text for text in told
                if "second process" in text or ("lost" in text and "state lost" not in text)]
        check(not harm, f"the robot's agents felt it: {harm}")
        print(f"operator served in {self.slowest:.2f} s at worst; server at most {peak >> 10} MiB")

    def server_alerts(self):
        found = self.query("alert", "list", "--limit", "1000")["alerts"]
        return [a["text"] for a in found if "the server is attacked" in a["text"]]

    def named(self, address, certificate=None):
        """The alert names the attacker."""
        texts = self.server_alerts()
        check(any(address in text for text in texts), f"no alert names {address}: {texts}")
        if certificate:
            check(any(certificate in text for text in texts),
                  f"no alert names {certificate}: {texts}")


def flood(fleet, pieces, seconds=None, reconnect=True, drain=True):
    """Sends until the server cuts it off, again and again. Gives how often it was cut off, and the
    bytes sent."""
    deadline = time.monotonic() + (seconds or ATTACK_S)
    cuts = sent = 0
    while time.monotonic() < deadline:
        try:
            client = fleet.attacker()
        except OSError:
            time.sleep(0.05)  # refused
            continue
        try:
            for piece in pieces():
                if time.monotonic() > deadline:
                    break
                client.send(piece)
                sent += len(piece)
                if drain:
                    client.drain()
        except OSError:
            cuts += 1
        finally:
            client.close()
        if not reconnect:
            break
    return cuts, sent


def flood_scenario(fleet, pieces, **options):
    fleet.arm()
    out = []
    fleet.run_beside(lambda: out.append(flood(fleet, pieces, **options)))
    cuts, sent = out[0]
    print(f"cut off {cuts} times, {sent >> 20} MiB sent")
    check(cuts > 0, f"it was never cut off, and sent {sent >> 20} MiB")
    fleet.unharmed()
    fleet.named("127.0.0.2")


@quick
def connections_that_wait(fleet):
    """1,500 connections that send six bytes; the server may open 1,024 files."""
    fleet.arm("prlimit", "--nofile=1024:1024")
    held = []

    def attack():
        for _ in range(1_500):
            waiting = socket.socket()
            waiting.settimeout(2)
            try:
                waiting.bind(("127.0.0.2", 0))
                waiting.connect(("127.0.0.1", fleet.port))
                waiting.sendall(b"PRI * ")
                held.append(waiting)
            except OSError:
                waiting.close()
        time.sleep(ATTACK_S)

    fleet.run_beside(attack)
    check(fleet.ready() == 200, "/readyz is not 200 during the attack")
    for waiting in held:
        waiting.close()
    fleet.unharmed()
    refused = sum(value for name, value in metrics(fleet.server).items()
                  if name.startswith("rips_connections_refused_total"))
    check(refused > 0, "no connection was refused")


@quick
def connections_from_everywhere(fleet):
    """The same from a hundred addresses, so that no limit of one address helps."""
    fleet.arm("prlimit", "--nofile=1024:1024")
    held = []

    def attack():
        for i in range(1_500):
            waiting = socket.socket()
            waiting.settimeout(2)
            try:
                waiting.bind((f"127.{1 + i % 100}.0.1", 0))
                waiting.connect(("127.0.0.1", fleet.port))
                held.append(waiting)
            except OSError:
                waiting.close()
        time.sleep(ATTACK_S)

    fleet.run_beside(attack)
    for waiting in held:
        waiting.close()
    fleet.unharmed()


@quick
def header_block_without_end(fleet):
    flood_scenario(fleet, http2.endless_header_block)


@quick
def streams_that_are_reset(fleet):
    flood_scenario(fleet, lambda: http2.streams(LIST_ROBOTS))


@scenario
def streams_of_no_method(fleet):
    flood_scenario(fleet, lambda: http2.streams(b"/no.such.Service/None"))


@scenario
def streams_without_a_path(fleet):
    flood_scenario(fleet, lambda: http2.streams(None))


@scenario
def streams_that_stay_open(fleet):
    flood_scenario(fleet, lambda: http2.streams(LIST_ROBOTS, resets=False))


@scenario
def pings_without_end(fleet):
    flood_scenario(fleet, http2.pings)


@scenario
def settings_that_are_not_read(fleet):
    flood_scenario(fleet, http2.settings, drain=False)


@quick
def four_at_a_time(fleet):
    """Endless header blocks over four connections, each made anew when it is cut off."""
    fleet.arm()
    cuts = []

    def attack():
        threads = [threading.Thread(
            target=lambda: cuts.append(flood(fleet, http2.endless_header_block)))
            for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    fleet.run_beside(attack)
    print(f"cut off {sum(c for c, _ in cuts)} times, {sum(s for _, s in cuts) >> 20} MiB sent")
    fleet.unharmed()
    fleet.named("127.0.0.2")


@quick
def a_stolen_key_is_throttled(fleet):
    """A viewer who was identified and then floods is named, and refused for a while."""
    fleet.arm()
    client = fleet.attacker()
    empty = b"\x00\x00\x00\x00\x00"
    client.send(http2.call(1, LIST_ROBOTS) +
                http2.frame(0, http2.END_STREAM, 1, empty))
    time.sleep(0.5)
    client.drain()
    try:
        for i in range(3, 2_003, 2):
            client.send(http2.call(i, LIST_ROBOTS) + http2.reset(i))
        time.sleep(1)
        client.send(http2.frame(http2.PING, 0, 0, b"12345678"))
        time.sleep(0.2)
        client.send(http2.frame(http2.PING, 0, 0, b"12345678"))
        raise Failed("a thousand calls in a moment were not too many")
    except OSError:
        pass
    fleet.unharmed()
    fleet.named("127.0.0.2", "operator/viewer/mallory")
    # From an address that is not banned.
    pki = fleet.key()
    code, _, error = run_ripsctl_as(fleet, pki)
    check(code == 1 and "try again in" in error, f"the key is not refused: {code} {error}")


def run_ripsctl_as(fleet, pki):
    done = subprocess.run(
        [str(fleet.bin / "ripsctl"), "--server", f"127.0.0.1:{fleet.port}", "--ca",
         f"{pki}/ca.pem", "--cert", f"{pki}/cert.pem", "--key", f"{pki}/key.pem", "robot", "list"],
        capture_output=True, text=True, timeout=30, env=fleet.env)
    return done.returncode, done.stdout, done.stderr


def main():
    if sys.argv[1:] in ([], ["--all"]):
        print("\n".join(SCENARIOS if sys.argv[1:] else QUICK))
        return 0
    if len(sys.argv) != 3 or sys.argv[2] not in SCENARIOS:
        print(__doc__, file=sys.stderr)
        return 2
    if os.environ.get("RIPS_SANITIZE"):
        print("skipped: memory and times are those of what ships")
        return 77
    name = sys.argv[2]
    directory = tempfile.mkdtemp(prefix=f"{name}.")
    fleet = Guarded(sys.argv[1], directory)
    try:
        SCENARIOS[name](fleet)
    except Failed as failed:
        print(f"FAILED {name}: {failed}")
        for process in fleet.processes:
            print(f"--- {process.name}")
            for _, line in process.lines[-15:]:
                print(line)
        return 1
    finally:
        fleet.stop()
        shutil.rmtree(directory, ignore_errors=True)
    print(f"passed {name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
