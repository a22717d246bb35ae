"""Robots that come to their certificates by a token and renew them: real processes.

    enrolment_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import pathlib
import shutil
import subprocess
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import SOURCE, Fleet, check, eventually, metrics, play  # noqa: E402


class EnrolledFleet(Fleet):
    """The server issues certificates; the agents' are where rips-enrol puts them."""

    program = None  # that signs in place of the key

    def prepare(self):
        super().prepare()
        self.mint("operator", "admin", "root")
        # What the server reads; a test changes these files, as an administrator would.
        shutil.copy(self.dir / "pki/ca.pem", self.dir / "trusted.pem")
        (self.dir / "issuing").mkdir()
        self.issue_by(self.dir / "pki")
        self.folder = self.dir / "etc-rips-pki"
        self.folder.mkdir()

    def signer(self):
        """What signs, in the configuration of the server."""
        if self.program is not None:
            return f"external_ca: {{program: [{self.program}, {self.dir}/issuing], timeout: 30s}}"
        return f"cert: {self.dir}/issuing/issuing.pem, key: {self.dir}/issuing/issuing.key"

    def sign_by(self, text):
        """A program signs from now on; `$SIGN` in the text is the shipped example."""
        self.program = self.dir / "sign"
        fresh = self.dir / "sign.fresh"
        fresh.write_text(f"#!/bin/bash\nSIGN={SOURCE}/deploy/pki/external-ca-openssl\n{text}\n")
        fresh.chmod(0o755)
        fresh.rename(self.program)

    def issue_by(self, authority):
        for name in ("pem", "key"):
            fresh = self.dir / f"issuing/fresh.{name}"
            shutil.copy(authority / f"ca/issuing.{name}", fresh)
            fresh.rename(self.dir / f"issuing/issuing.{name}")

    def trust(self, *roots):
        fresh = self.dir / "trusted.fresh"
        fresh.write_text("".join((root / "ca.pem").read_text() for root in roots))
        fresh.rename(self.dir / "trusted.pem")

    def tls(self, *path):
        if path[0] in ("sensor", "actuator"):
            directory = self.folder / path[0]
            return (f"{{ca: {directory}/ca.pem, cert: {directory}/cert.pem, "
                    f"key: {directory}/key.pem}}")
        return super().tls(*path)

    def write_server_config(self, port):
        super().write_server_config(port)
        path = self.dir / "policy-server.yaml"
        text = path.read_text().replace(f"ca: {self.dir}/pki/server/ps1/ca.pem",
                                        f"ca: {self.dir}/trusted.pem")
        path.write_text(text + f"enrolment: {{{self.signer()}, life: 24h}}\n")

    def as_admin(self, *args, check_code=True):
        args = self.ripsctl_args(*args, who="admin/root")
        done = subprocess.run(args, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                              timeout=30, env=self.env)
        check(not check_code or done.returncode == 0, f"{args}: {done.stderr}")
        return done

    def token(self, *options):
        path = self.dir / f"token-{time.monotonic_ns()}"
        self.as_admin("enrol", "create-token", "r1", "base", "--out", path, *options)
        return path

    def enrol(self, *args, code=0, folder=None):
        done = self.rips_enrol(folder or self.folder, *args)
        check(done.returncode == code, f"rips-enrol {args} ended with {done.returncode}: "
                                       f"{done.stdout}{done.stderr}")
        return done.stdout + done.stderr

    def renew(self):
        """Of both agents; no sooner than the server lets each of them, which may not be at once."""
        before = self.serials()

        def renewed():
            self.rips_enrol(self.folder, "renew", "--now")
            return all(serial != before[role] for role, serial in self.serials().items())
        eventually(renewed, 40, "renewed", every=1)

    def serials(self):
        return {role: subprocess.run(
            ["openssl", "x509", "-in", self.folder / role / "cert.pem", "-noout", "-serial"],
            check=True, capture_output=True, text=True).stdout.partition("=")[2].strip().lower().lstrip("0")
            for role in ("sensor", "actuator")}

    def connected(self):
        """Serial numbers that the server has seen."""
        return {each["uri"].split("/")[-2]: each["serial"]
                for each in self.query("agent", "list")["agents"] if "/robot/" in each["uri"]}

    def arm_enrolled(self):
        """Agents that are started before they have certificates, which then come."""
        self.prepare()
        self.robot = self.start_robot()
        self.server = self.start_server()
        for role in ("sensor", "actuator"):
            (self.folder / role).mkdir()
        self.sensor = self.start_agent("sensor", wait=False)
        self.actuator = self.start_agent("actuator", wait=False)
        used = self.token()
        out = self.enrol("fetch", "--token", used)
        check("sensor of r1 on base: enrolled" in out and "actuator of r1 on base: enrolled" in out,
              out)
        self.wait_level("DEFAULT", 60)
        return used


def a_token_brings_a_robot_its_certificates(fleet):
    """Once; what came of it is in the list, the alerts and the audit log."""
    used = fleet.arm_enrolled()
    thief = fleet.dir / "thief"
    thief.mkdir()
    out = fleet.enrol("fetch", "--token", used, code=1, folder=thief)
    check("used already, by another key" in out, out)
    check(not (thief / "sensor/cert.pem").exists(), "the thief has a certificate")
    listed = fleet.query("enrol", "list", "r1")
    check([each["state"] for each in listed["tokens"]] == ["used"], f"{listed}")
    issued = {each["uri"].split("/")[-2]: each["serial"] for each in listed["issued"]}
    check(issued == fleet.serials() == fleet.connected(), f"{issued} {fleet.serials()}")
    check(sum("was enrolled with token" in each["text"] for each in fleet.alerts()) == 2,
          f"{fleet.alerts()}")
    tail = fleet.ripsctl("audit", "tail", str(fleet.dir / "server/audit"), "--limit", "1000")[1]
    for call in ("CreateEnrolmentToken", "Enrol"):
        check(call in tail, f"{call} is not in the audit log")
    check("BEGIN" not in tail, "a key or a request is in the audit log")
    for serial in issued.values():
        check(serial in tail, f"{serial} is not in the audit log")
    check(listed["tokens"][0]["id"] in tail, "the token is not in the audit log")

    revoked = fleet.token()
    fleet.as_admin("enrol", "revoke-token", fleet.query("enrol", "list")["tokens"][0]["id"])
    check("revoked" in fleet.enrol("fetch", "--token", revoked, code=1, folder=thief), "revoked")
    refused = fleet.ripsctl("enrol", "create-token", "r1", "base", check=False)
    check(refused[0] == 1 and "needs the role `admin`" in refused[2], f"an operator may: {refused}")
    refused = fleet.as_admin("enrol", "create-token", "r9", "base", check_code=False)
    check(refused.returncode == 1 and "robots.yaml" in refused.stderr, f"{refused}")


def certificates_are_renewed_under_open_streams(fleet):
    """Nothing ends while they are renewed; the next connection shows the new ones."""
    fleet.arm_enrolled()
    check("not due yet" in fleet.enrol("renew"), "it is due at once")
    before = fleet.serials()
    marks = {each: len(each.lines) for each in (fleet.sensor, fleet.actuator)}
    fleet.renew()
    after = fleet.serials()
    check(all(before[role] != after[role] for role in before), f"{before} {after}")
    time.sleep(3)
    for agent, mark in marks.items():
        lost = [line for _, line in agent.lines[mark:] if "disconnect" in line or "lease" in line]
        check(not lost, f"{agent.name}: {lost}")
    fleet.wait_level("DEFAULT", 5)
    fleet.server.kill()
    fleet.server = fleet.start_server()
    fleet.wait_level("DEFAULT", 60)
    eventually(lambda: fleet.connected() == after, 20, "they connect with the new ones")


def another_root_takes_over_without_a_gap(fleet):
    """Old and new root trusted, then signed by the new one, then the old one forgotten: the robot is
    held all the while, and the server is not restarted."""
    fleet.arm_enrolled()
    mark = len(fleet.actuator.lines)
    old, new = fleet.dir / "pki", fleet.dir / "new-pki"
    for args in (("init",), ("server", "ps1"), ("operator", "operator", "alice")):
        subprocess.run([SOURCE / "deploy/pki/mint", "--dir", new, "--trust-domain", "fleet.example",
                        *args], check=True, stdout=subprocess.DEVNULL)
    fleet.trust(old, new)
    time.sleep(3)  # the server looks at its files each second
    fleet.renew()  # now the agents trust both
    time.sleep(3)
    # The server's own, and who signs; operators get theirs.
    fleet.issue_by(new)
    server = old / "server/ps1"
    target = server.resolve()
    fresh = target.parent / "fresh"
    shutil.copytree((new / "server/ps1").resolve(), fresh)
    link = server.parent / "ps1.link"
    link.symlink_to(fresh)
    link.rename(server)
    alice = old / "operator/operator/alice"
    link = alice.parent / "alice.link"
    link.symlink_to((new / "operator/operator/alice").resolve())
    both = (old / "ca.pem").read_text() + (new / "ca.pem").read_text()
    ((new / "operator/operator/alice") / "ca.pem").write_text(both)
    link.rename(alice)
    time.sleep(3)
    fleet.renew()
    fleet.trust(new)
    time.sleep(3)
    fleet.renew()
    for role in ("sensor", "actuator"):
        check((fleet.folder / role / "ca.pem").read_text() == (new / "ca.pem").read_text(),
              f"the {role} still trusts the old root")
    status = fleet.level()
    check((status["decided_level"], status["stage"]) == ("DEFAULT", "verified"), f"{status}")
    floors = [line for _, line in fleet.actuator.lines[mark:] if "floor=ALERT" in line]
    check(not floors, f"{floors}")
    time.sleep(3)  # the agents look at their files each second
    fleet.server.kill()
    fleet.server = fleet.start_server()
    fleet.wait_level("DEFAULT", 60)
    eventually(lambda: fleet.connected() == fleet.serials(), 20, "they connect under the new root")


def a_program_signs_what_a_robot_enrols_and_renews_with(fleet):
    """The key is not the server's. A program that is busy, or signs something else, costs neither
    the token nor the robot its level."""
    good = 'exec "$SIGN" "$@"'
    fleet.sign_by(good)
    used = fleet.arm_enrolled()
    thief = fleet.dir / "thief"
    thief.mkdir()
    out = fleet.enrol("fetch", "--token", used, code=1, folder=thief)
    check("used already, by another key" in out, out)
    before = fleet.serials()
    fleet.renew()
    after = fleet.serials()
    check(all(before[role] != after[role] for role in before), f"{before} {after}")
    issued = {each["serial"] for each in fleet.query("enrol", "list", "r1")["issued"]}
    check(issued == {*before.values(), *after.values()}, f"{issued} {before} {after}")

    again = fleet.token("--role", "sensor")
    spare = fleet.dir / "spare"
    spare.mkdir()
    for text, why in (("echo sealed >&2; exit 75", "asks to try again later"),
                      ("exit 1", "refused with exit code 1"),
                      ('export RIPS_DAYS=90; exec "$SIGN" "$@"', "valid for too long"),
                      ('export RIPS_IDENTITY=${RIPS_IDENTITY/base/arm}; exec "$SIGN" "$@"',
                       "its subject alternative name must be")):
        fleet.sign_by(text)
        time.sleep(1.1)  # between two calls with one token
        out = fleet.enrol("fetch", "--token", again, code=1, folder=spare)
        check(why in out and "check that the policy server runs" not in out, f"{why}: {out}")
        check(not (spare / "sensor/cert.pem").exists(), f"{why}: a certificate")
    counted = metrics(fleet.server)["rips_enrolment_ca_failures_total"]
    check(counted == 4, f"{counted} failures are counted")
    check(any("stderr=sealed" in line for _, line in fleet.server.lines), "what it said is lost")
    alerts = [each["text"] for each in fleet.alerts() if "no certificate for" in each["text"]]
    check(len(alerts) >= 1 and not any("sealed" in each for each in alerts), f"{alerts}")
    listed = [each["state"] for each in fleet.query("enrol", "list", "r1")["tokens"]]
    check(sorted(listed) == ["open", "used"], f"{listed}")
    fleet.sign_by(good)
    time.sleep(1.1)
    fleet.enrol("fetch", "--token", again, folder=spare)
    fleet.wait_level("DEFAULT", 5)

    # One that hangs does not hold up the server's end.
    fleet.sign_by(f"echo $$ > {fleet.dir}/hangs; exec sleep 600")
    hangs = fleet.dir / "hangs"
    asking = []

    def runs():
        # The server may say first that it is too soon.
        if not asking or asking[-1].poll() is not None:
            asking.append(subprocess.Popen(
                [*fleet.within, fleet.path_of("rips-enrol"), "renew", "--now", "--dir",
                 fleet.folder], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL, env=fleet.env))
        return hangs.exists() and hangs.read_text().strip()
    try:
        eventually(runs, 30, "the program runs", every=0.5)
        fleet.server.kill()
        check(not pathlib.Path("/proc", hangs.read_text().strip()).exists(), "it runs on")
    finally:
        for each in asking:
            each.kill()
            each.wait()


SCENARIOS = [a_token_brings_a_robot_its_certificates, certificates_are_renewed_under_open_streams,
             another_root_takes_over_without_a_gap,
             a_program_signs_what_a_robot_enrols_and_renews_with]


if __name__ == "__main__":
    sys.exit(play(SCENARIOS, EnrolledFleet))
