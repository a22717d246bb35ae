"""Alerts leave the policy server over real sockets: webhooks and a syslog receiver that fail in every
way, and a server that is killed meanwhile.

    outputs_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import hashlib
import hmac
import http.client
import json
import os
import pathlib
import shutil
import signal
import socket
import ssl
import struct
import subprocess
import sys
import tempfile
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import SOURCE, Failed, Fleet, check, page, perform  # noqa: E402

LEVELS = ("DEFAULT", "ALERT", "HALT")
RULES = """levels: DEFAULT; ALERT; HALT;
rules External:
  bell: signal("SIGUSR1") ? alert("rung", "high");
  others: false ? trigger(ALERT), trigger(HALT);
"""
SECRET = "hunter2-of-the-pager"


def certificate(directory, name, san):
    """A certificate that is its own authority, as (certificate, key)."""
    cert, key = directory / f"{name}.pem", directory / f"{name}.key"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1",
         "-nodes", "-keyout", key, "-out", cert, "-days", "2", "-subj", f"/CN={name}", "-addext",
         f"subjectAltName={san}"], check=True, stderr=subprocess.DEVNULL)
    return cert, key


class Receiver:
    """Listens on one port of loopback over TLS, and can go and come back. `mode` says what it does
    with a connection; what it accepts is in `got`, as JSON objects in the order of arrival."""

    def __init__(self, cert, key):
        self.tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self.tls.load_cert_chain(cert, key)
        self.port = 0
        self.mode = "ok"
        self.got = []
        self.seen = set()  # modes in which a connection came
        self.over = threading.Event()
        self.come()

    def come(self):
        self.listening = socket.create_server(("127.0.0.1", self.port))
        self.port = self.listening.getsockname()[1]
        threading.Thread(target=self._run, args=(self.listening,), daemon=True).start()

    def go(self):
        self.listening.shutdown(socket.SHUT_RDWR)
        self.listening.close()

    def stop(self):
        self.over.set()
        self.go()

    def _run(self, listening):
        while True:
            try:
                raw, _ = listening.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(raw, listening), daemon=True).start()

    def _serve(self, raw, listening):
        raw.settimeout(30)
        try:
            with self.tls.wrap_socket(raw, server_side=True) as stream:
                self.serve(stream, listening)
        except OSError:
            pass

    def reset(self, stream):
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

    def ids(self):
        """Each once, in the order of their first arrival."""
        return list(dict.fromkeys(each["id"] if "id" in each else each["finding_info"]["uid"]
                                  for each in list(self.got)))


class Hook(Receiver):
    def serve(self, stream, listening):
        mode = self.mode
        self.seen.add(mode)
        if mode == "close":  # in the middle of the request
            stream.recv(100)
            return self.reset(stream)
        if mode == "hang":
            while self.mode == "hang" and not self.over.wait(0.05):
                pass
            return self.reset(stream)
        rest = stream.makefile("rb")
        check(rest.readline() == b"POST /rips HTTP/1.1\r\n", "it is a POST")
        headers = http.client.parse_headers(rest)
        body = rest.read(int(headers["Content-Length"]))
        if mode == "500":
            return stream.sendall(b"HTTP/1.1 500 No\r\nContent-Length: 0\r\n\r\n")
        stamp = headers["X-Rips-Timestamp"]
        wanted = hmac.new(SECRET.encode(), f"{stamp}.".encode() + body, hashlib.sha256).hexdigest()
        if headers["X-Rips-Signature"] != f"sha256={wanted}":
            return stream.sendall(b"HTTP/1.1 401 Unsigned\r\nContent-Length: 0\r\n\r\n")
        self.got += json.loads(body)
        stream.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n")


class Siem(Receiver):
    def serve(self, stream, listening):
        pending = b""
        while self.listening is listening:
            mode = self.mode
            more = stream.recv(65536)
            if not more:
                return
            self.seen.add(mode)
            if mode == "close":  # what it has read is lost
                return self.reset(stream)
            pending += more
            while True:
                length, space, rest = pending.partition(b" ")
                if not space or len(rest) < int(length):
                    break
                message, pending = rest[:int(length)], rest[int(length):]
                self.got.append(json.loads(message.partition(b"] \xef\xbb\xbf")[2]))


class OutputsFleet(Fleet):
    """A robot without DDS (SimRobots), a server with outputs, and their receivers."""

    def prepare(self):
        from sim_robots import SimRobots
        super().prepare()
        self.write("bundles/bell/bell.rul", RULES)
        self.write("bundles/bell/manifest.yaml",
                   f"name: bell\nrules: [bell.rul]\nlevels: [{', '.join(LEVELS)}]\n")
        self.good = certificate(self.dir, "good", "IP:127.0.0.1")
        self.other = certificate(self.dir, "other", "IP:127.0.0.1")
        self.misnamed = certificate(self.dir, "misnamed", "DNS:other.example")
        self.hook, self.findings = Hook(*self.good), Hook(*self.good)
        self.siem = Siem(*self.good)
        self.hung, self.strange, self.wrong = Hook(*self.good), Hook(*self.other), Siem(*self.misnamed)
        self.hung.mode = "hang"
        self.receivers = [self.hook, self.findings, self.siem, self.hung, self.strange, self.wrong]
        self.write("pager.secret", SECRET + "\n")
        self.write_server_config(0)
        self.server = self.start_server()
        self.robots = SimRobots(self.port, self.dir / "pki", ["r1"], LEVELS)
        self.robots.start()

    def write_server_config(self, port):
        super().write_server_config(port)
        if not hasattr(self, "hook"):
            return

        def hook(name, receiver, more):
            return (f'  - {{name: {name}, kind: webhook, url: "https://127.0.0.1:{receiver.port}/rips", '
                    f'ca: {self.good[0]}, secret_file: {self.dir}/pager.secret{more}}}\n')

        def siem(name, receiver, ca):
            return (f'  - {{name: {name}, kind: syslog, address: "127.0.0.1:{receiver.port}", '
                    f'tls: {{ca: {ca}}}}}\n')
        with open(self.dir / "policy-server.yaml", "a", encoding="utf-8") as config:
            config.write("outputs:\n" + hook("pager", self.hook, "") +
                         hook("findings", self.findings, ", format: ocsf, severity: high") +
                         siem("siem", self.siem, self.good[0]) + hook("hung", self.hung, "") +
                         hook("strange", self.strange, "") +
                         siem("wrong", self.wrong, self.misnamed[0]))

    def stop(self):
        if hasattr(self, "robots"):
            self.robots.stop()
        super().stop()
        for receiver in getattr(self, "receivers", []):
            receiver.stop()

    def raised(self):
        """All alerts, as the alert file has them."""
        return [json.loads(line) for line in
                (self.dir / "server/alerts.jsonl").read_text().splitlines()]

    def ring(self, count=3):
        """So many alerts of the robot's rule."""
        for _ in range(count):
            before = len(self.raised())
            self.robots["r1"].signal("SIGUSR1")
            self.until(20, "an alert", lambda: len(self.raised()) > before)

    def until(self, seconds, what, holds):
        deadline = time.monotonic() + seconds
        while not (value := holds()):
            if time.monotonic() > deadline:
                raise Failed(f"{what}: not within {seconds} s")
            time.sleep(0.05)
        return value

    def wait_delivered(self, seconds, what):
        """Until each receiver has had every alert, and their first arrivals are in order."""
        all_ids = [each["id"] for each in self.raised()]
        high = [each["id"] for each in self.raised() if each["severity"] in ("high", "critical")]

        def missing():
            return [name for name, receiver, ids in (("pager", self.hook, all_ids),
                                                     ("siem", self.siem, all_ids),
                                                     ("findings", self.findings, high))
                    if not set(ids) <= set(receiver.ids())]
        self.until(seconds, f"{what}: every alert has arrived", lambda: not missing())
        wanted = {"pager": (self.hook, all_ids), "siem": (self.siem, all_ids),
                  "findings": (self.findings, high)}
        for name, (receiver, ids) in wanted.items():
            got = [each for each in receiver.ids() if each in ids]
            check(got == ids, f"{what}: {name} got them in another order: {got} {ids}")

    def metric(self, name, **labels):
        wanted = "{" + ",".join(f'{key}="{value}"' for key, value in labels.items()) + "}"
        for line in page(self.server, "metrics").splitlines():
            if line.startswith(name + wanted + " "):
                return float(line.rpartition(" ")[2])
        raise Failed(f"there is no {name}{wanted}")


def check_schema(fleet):
    """What was written and sent is as the schemas of deploy/schema say."""
    try:
        import jsonschema
    except ImportError:
        sys.path.append("/usr/lib/python3/dist-packages")  # another Python than Debian's
        try:
            import jsonschema
        except ImportError:
            print("note: python3-jsonschema is not there; formats are not checked")
            return
    for name, objects in (("alert", fleet.raised() + fleet.hook.got + fleet.siem.got),
                          ("ocsf-detection-finding", fleet.findings.got)):
        schema = json.loads((SOURCE / f"deploy/schema/{name}.schema.json").read_text())
        jsonschema.Draft202012Validator.check_schema(schema)
        validator = jsonschema.Draft202012Validator(schema)
        check(objects, f"there is no {name} to check")
        for each in objects:
            for problem in validator.iter_errors(each):
                raise Failed(f"{name}: {problem.message} in {each}")
        spoiled = dict(objects[0], more=1)
        check(not validator.is_valid(spoiled), f"the schema of {name} takes anything")


def every_alert_arrives_whatever_receivers_do(fleet):
    fleet.prepare()
    fleet.ring()
    fleet.wait_delivered(20, "at first")
    for mode, seen in (("500", fleet.hook), ("close", fleet.hook), ("hang", fleet.hook)):
        fleet.hook.mode = fleet.findings.mode = mode
        fleet.siem.mode = "close" if mode == "close" else "ok"
        fleet.ring()
        fleet.until(20, f"the receivers {mode}", lambda: mode in seen.seen and (
            mode != "close" or "close" in fleet.siem.seen))
        if mode == "hang":
            begun = time.monotonic()
            fleet.ripsctl("level", "raise", "r1", "--to", "ALERT", "--reason", "while it hangs")
            took = time.monotonic() - begun
            most = 5 if os.environ.get("RIPS_SANITIZE") else 1  # s
            check(took < most, f"a raise took {took:.2f} s while webhooks hang")
            print(f"a raise took {took * 1000:.0f} ms while two webhooks hang")
        fleet.hook.mode = fleet.findings.mode = fleet.siem.mode = "ok"
        fleet.wait_delivered(40, f"after {mode}")
    check("hang" in fleet.hung.seen and not fleet.hung.got, "one webhook hangs for ever")
    # All are away while the server is killed; they come back after 10 s.
    for receiver in (fleet.hook, fleet.findings, fleet.siem):
        receiver.go()
    fleet.ring()
    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()
    fleet.ring()
    time.sleep(10)
    for receiver in (fleet.hook, fleet.findings, fleet.siem):
        receiver.come()
    fleet.ring()
    fleet.wait_delivered(60, "after all were away and the server was killed")
    # Killed while it delivers.
    fleet.ring()
    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()
    fleet.wait_delivered(40, "after a kill")
    check(not fleet.strange.got and not fleet.wrong.got,
          "nothing is sent to a certificate of another authority or name")
    check_schema(fleet)
    check_reports(fleet)


def check_reports(fleet):
    fleet.until(10, "the gauges follow", lambda: fleet.metric(
        "rips_output_behind", output="pager") == 0)
    for name, healthy in (("pager", 1), ("siem", 1), ("hung", 0), ("strange", 0), ("wrong", 0)):
        fleet.until(20, f"the health of {name} is {healthy}", lambda name=name, healthy=healthy:
                    fleet.metric("rips_output_healthy", output=name) == healthy)
    check(fleet.metric("rips_output_behind", output="hung") > 0, "hung is behind")
    check(fleet.metric("rips_output_failures_total", output="strange") > 0, "failures are counted")
    log = (fleet.dir / "policy-server.log").read_text()
    for words in ("certificate of the receiver is not accepted: self-signed certificate",
                  "certificate of the receiver is not accepted: IP address mismatch"):
        check(words in log, f"the log says: {words}")
    shown = subprocess.run([fleet.bin / "rips-policy-server", "--config",
                            fleet.dir / "policy-server.yaml", "--check-config"],
                           capture_output=True, text=True, check=True).stdout
    check("outputs[0].secret_file" in shown, shown)
    for what, text in (("the log", log), ("--check-config", shown),
                       ("the metrics", page(fleet.server, "metrics"))):
        check(SECRET not in text, f"the secret is in {what}")


SCENARIOS = [every_alert_arrives_whatever_receivers_do]


def main():
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    scenario = next(each for each in SCENARIOS if each.__name__ == sys.argv[2])
    parent = pathlib.Path(sys.argv[1]).resolve().parent / "scenarios"
    parent.mkdir(exist_ok=True)
    directory = pathlib.Path(tempfile.mkdtemp(prefix="outputs.", dir=parent))
    code = perform(scenario.__name__, scenario, OutputsFleet(sys.argv[1], directory, bundle="bell"))
    if code == 0:
        shutil.rmtree(directory)
    return code


if __name__ == "__main__":
    sys.exit(main())
