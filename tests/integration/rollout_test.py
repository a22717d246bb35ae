"""Twenty robots and one policy server, as processes: new rules reach them stage by stage, and stop
where they do harm.

    rollout_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import json
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import Failed, Fleet, check, perform  # noqa: E402

ROBOTS = [f"r{number:02}" for number in range(1, 21)]
CANARIES = ROBOTS[:2]
LEVELS = ("DEFAULT", "ALERT", "HALT")
# The first version does nothing about the bell, the second one raises an alert, the third a level.
RULES = """# {mark}
levels: DEFAULT; ALERT; HALT;
rules External:
  bell: signal("{signal}") ? {action};
  others: false ? trigger(ALERT), trigger(HALT);
"""


class ManyRobots(Fleet):
    def prepare(self):
        from sim_robots import SimRobots
        self.mint("init")
        self.mint("server", "ps1")
        for name in ROBOTS:
            self.mint("sensor", name, "base")
            self.mint("actuator", name, "base")
        self.mint("operator", "admin", "root")
        self.mint("operator", "viewer", "vera")
        (self.dir / "server").mkdir()
        self.write("robots.yaml", "robots:\n" + "".join(
            f"  - {{id: {name}, bundle: hall, sensors: [{{host: base, primary: true}}], "
            f"actuators: [base], labels: {{ring: {'canary' if name in CANARIES else 'main'}}}}}\n"
            for name in ROBOTS))
        self.bundle_files("bundles/hall", "first", 'alert("no bell", "low")', "SIGUSR2")
        self.write_server_config(0)
        self.server = self.start_server()
        self.robots = SimRobots(self.port, self.dir / "pki", ROBOTS, LEVELS)
        self.robots.start()

    def bundle_files(self, path, mark, action, signal_name="SIGUSR1"):
        self.write(f"{path}/hall.rul", RULES.format(mark=mark, action=action, signal=signal_name))
        self.write(f"{path}/manifest.yaml", f"""name: hall
rules: [hall.rul]
levels: [{", ".join(LEVELS)}]
""")
        return self.dir / path

    def stop(self):
        if hasattr(self, "robots"):
            self.robots.stop()
        super().stop()

    def admin(self, *args, role="admin", name="root", check_code=True, timeout=120):
        """(exit code, stdout, stderr) of ripsctl with the administrator's key."""
        pki = self.dir / "pki/operator" / role / name
        done = subprocess.run(
            [self.bin / "ripsctl", "--server", f"127.0.0.1:{self.port}", "--ca", pki / "ca.pem",
             "--cert", pki / "cert.pem", "--key", pki / "key.pem", *args],
            capture_output=True, text=True, timeout=timeout, env=self.env)
        # `rules status` exits with 1 if a robot is not judged as it should be.
        allowed = (0, 1) if args[-2:] == ("rules", "status") or "status" in args else (0,)
        if check_code and done.returncode not in allowed:
            raise Failed(f"ripsctl {args} ended with {done.returncode}: {done.stderr}{done.stdout}")
        return done.returncode, done.stdout, done.stderr

    def ask(self, *args):
        return json.loads(self.admin("--output", "json", *args)[1])

    def in_use(self):
        """Robot to the id of the bundle that judges it."""
        return {each["robot"]: each["bundle_in_use"] for each in self.ask("rules", "status")["robots"]}

    def push(self, mark, action):
        directory = self.bundle_files(f"pushed/{mark}", mark, action)
        return self.ask("rules", "push", str(directory))["id"]

    def until(self, seconds, what, found):
        deadline = time.monotonic() + seconds
        while not (value := found()):
            check(time.monotonic() < deadline, f"{what}: not within {seconds} s: "
                  f"{json.dumps(self.ask('rules', 'status'))[:2000]}")
            time.sleep(0.5)
        return value

    def wait_quiet(self):
        """All robots are attached, at DEFAULT, and nothing is wrong with them."""
        deadline = time.monotonic() + 60
        while True:
            robots = self.ask("robot", "list")["robots"]
            unwell = [each for each in robots
                      if each["effective_level"] != "DEFAULT" or each["degraded"]]
            if len(robots) == len(ROBOTS) and not unwell:
                return
            check(time.monotonic() < deadline, f"robots are not well after 60 s: {unwell[:3]}")
            time.sleep(0.5)


STAGES = ("--stage", "ring=canary", "--stage", "50%", "--stage", "100%", "--soak", "2s")


def reaches_all_robots_stage_by_stage(fleet):
    fleet.wait_quiet()
    old = fleet.in_use()
    fresh = fleet.push("second", 'alert("rung", "low")')
    check(fleet.in_use() == old, "a push changes what judges robots")
    shown = fleet.admin("rules", "activate", fresh, "--all", *STAGES, "--reason", "x", "--dry-run")[1]
    check("r01" in shown and fleet.in_use() == old, f"a dry run: {shown}")
    code, out, err = fleet.admin("rules", "activate", fresh, "--all", *STAGES, "--reason",
                                 "a bell that is heard", "--wait")
    check(code == 0, f"{out}{err}")
    check(set(fleet.in_use().values()) == {fresh}, f"{fleet.in_use()}")
    fleet.robots["r20"].signal("SIGUSR1")
    fleet.until(10, "the new rules judge", lambda: [
        a for a in fleet.ask("alert", "list", "r20", "--limit", "50")["alerts"] if a["rule"] == "bell"])
    lost = {name: fleet.robots[name].lost for name in ROBOTS if fleet.robots[name].lost}
    check(not lost, f"streams were lost: {lost}")
    fleet.admin("rules", "rollback", "--all", "--reason", "too loud")
    check(fleet.in_use() == old, "the roll-back takes robots back to what judged them")


def stops_by_itself_when_a_robot_is_degraded(fleet):
    fleet.wait_quiet()
    old = fleet.in_use()
    fresh = fleet.push("second", 'alert("rung", "low")')
    fleet.admin("rules", "activate", fresh, "--all", *STAGES[:-2], "--soak", "6s", "--reason", "new")
    fleet.until(30, "the second stage begins",
                lambda: sum(each == fresh for each in fleet.in_use().values()) == 10)
    fleet.robots["r07"].silent = True
    rollout = fleet.until(60, "the roll-out stops", lambda: (
        lambda r: r if r["state"] == "stopped" else None)(fleet.ask("rules", "status")["rollout"]))
    check("r07" in rollout["why"] and "degraded" in rollout["why"], rollout["why"])
    used = fleet.in_use()
    check([name for name in ROBOTS if used[name] == fresh] == ROBOTS[:10],
          f"robots of the last stage are left alone: {used}")
    check(all(used[name] == old[name] for name in ROBOTS[10:]), "they are judged as before")
    alerts = fleet.ask("alert", "list", "--limit", "200")["alerts"]
    check(any(a["robot"] == "(server)" and "stopped at stage 2 of 3: r07" in a["text"]
              for a in alerts), f"an alert says so: {[a['text'] for a in alerts]}")
    shown = fleet.admin("rules", "status")[1]
    check("stopped" in shown and "r07" in shown, shown)
    fleet.admin("rules", "rollback", "--all", "--reason", "r07 is silent")
    check(fleet.in_use() == old, "the roll-back takes them back")


def stops_by_itself_when_rules_raise_a_level_and_goes_back(fleet):
    fleet.wait_quiet()
    old = fleet.in_use()
    fresh = fleet.push("third", "trigger(ALERT)")
    waiting = fleet.start("activate", *admin_args(fleet, "rules", "activate", fresh, "--all", *STAGES,
                                                  "--reason", "new", "--rollback", "--wait"))
    fleet.until(20, "the first stage begins", lambda: fleet.in_use()["r01"] == fresh)
    fleet.robots["r01"].signal("SIGUSR1")
    check(waiting.child.wait(60) == 1, "--wait exits with 1 when it stopped")
    fleet.until(10, "robots go back", lambda: fleet.in_use() == old)
    why = fleet.ask("rules", "status")["rollout"]["why"]
    check("r01" in why and "its level rose to ALERT" in why, why)
    check(fleet.ask("level", "show", "r01")["status"]["decided_level"] == "ALERT",
          "the level that was decided stands")


def goes_on_after_the_server_was_killed(fleet):
    fleet.wait_quiet()
    old = fleet.in_use()
    fresh = fleet.push("second", 'alert("rung", "low")')
    fleet.admin("rules", "activate", fresh, "--all", "--stage", "ring=canary", "--stage", "100%",
                "--soak", "600s", "--reason", "new")
    fleet.until(10, "the first stage begins", lambda: fleet.in_use()["r01"] == fresh)
    before = fleet.in_use()
    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()
    check(fleet.in_use() == before, "each robot is judged by what judged it before")
    status = fleet.ask("rules", "status")["rollout"]
    check(status["state"] == "running" and status["stages"][0]["robots"] == CANARIES, f"{status}")
    fleet.admin("rules", "stop", "--reason", "enough")
    # A damaged file: each robot keeps what judged it, and an alert says so.
    fleet.server.kill()
    activated = fleet.dir / "server/bundles/activated.json"
    activated.write_text(activated.read_text()[:100])
    fleet.server = fleet.start_server()
    check(fleet.in_use() == before, "each robot keeps what judged it last")
    texts = [a["text"] for a in fleet.ask("alert", "list", "--limit", "200")["alerts"]]
    check(any("which bundles were activated is not known" in text for text in texts), f"{texts}")
    fleet.admin("rules", "activate", "directory", "--robot", "r01", "--robot", "r02", "--reason",
                "back to the files")
    fleet.until(10, "the directory judges", lambda: fleet.in_use() == old)


def a_shadow_reports_and_judges_nothing(fleet):
    fleet.wait_quiet()
    old = fleet.in_use()
    fresh = fleet.push("third", "trigger(ALERT)")
    fleet.admin("rules", "shadow", fresh, "--label", "ring=canary", "--reason", "what would it do?")
    for _ in range(3):
        fleet.robots["r01"].signal("SIGUSR1")
        time.sleep(1)
    report = fleet.until(20, "the shadow reports", lambda: (
        lambda s: s if s["would"]["raises"] > 0 else None)(
            fleet.ask("rules", "status", "r01")["robots"][0]["shadow"]))
    check(report["level"] == "ALERT" and report["live_level"] == "DEFAULT", f"{report}")
    check(report["live"]["raises"] == 0 and report["missed"] == 0, f"{report}")
    check(any(each["kind"] == "raise" and each["rule"] == "bell" for each in report["examples"]),
          f"{report['examples']}")
    check(fleet.in_use() == old, "it judges nothing")
    check(fleet.ask("level", "show", "r01")["status"]["decided_level"] == "DEFAULT", "nor raises")
    text = fleet.admin("rules", "status", "r01", role="viewer", name="vera")[1]
    check("bell" in text and "ALERT" in text, text)
    fleet.server.kill(signal.SIGKILL)
    fleet.server = fleet.start_server()
    fleet.until(20, "it begins again", lambda: (
        fleet.ask("rules", "status", "r01")["robots"][0]["shadow"]))
    fleet.admin("rules", "shadow", "--end", "--all", "--reason", "seen")
    check(not fleet.ask("rules", "status", "r01")["robots"][0]["shadow"], "it has ended")
    lost = sum(fleet.robots[name].lost for name in ROBOTS)
    check(lost <= 2 * len(ROBOTS), f"{lost} streams were lost; the server was started anew once")


def only_signed_bundles_come_into_force(fleet):
    """With `bundles.keys` what is not signed is refused wherever it comes from; the last good bundle
    goes on, so that setting keys for the first time leaves no robot without a policy."""
    fleet.wait_quiet()
    old = fleet.in_use()
    key, public = fleet.dir / "alice.key", fleet.dir / "alice.pem"
    for command in (["genpkey", "-algorithm", "ed25519", "-out", key],
                    ["pkey", "-in", key, "-pubout", "-out", public]):
        subprocess.run(["openssl", *command], check=True, stdout=subprocess.DEVNULL)
    key.chmod(0o600)
    fleet.server.kill()
    config = fleet.dir / "policy-server.yaml"
    write = fleet.write_server_config

    def with_keys(port):
        write(port)
        config.write_text(config.read_text().replace("server/bundles}",
                                                     f"server/bundles, keys: [{public}]}}"))
    fleet.write_server_config = with_keys
    fleet.server = fleet.start_server()
    fleet.until(30, "robots come back", lambda: fleet.in_use() == old)
    code, _, _ = fleet.admin("rules", "status", check_code=False)
    check(code == 1, "robots are not judged by what they should be")
    texts = [a["text"] for a in fleet.ask("alert", "list", "--limit", "200")["alerts"]]
    check(any("no signature" in t or "not signed" in t or "signature" in t for t in texts), f"{texts}")
    bundle = fleet.bundle_files("pushed/signed", "signed", 'alert("rung", "low")')
    code, _, error = fleet.admin("rules", "push", str(bundle), check_code=False)
    check(code == 1 and "rules sign" in error, f"{code} {error}")
    fleet.admin("rules", "sign", str(bundle), "--key", str(key))
    fresh = fleet.ask("rules", "push", str(bundle))["id"]
    fleet.admin("rules", "activate", fresh, "--all", "--soak", "1s", "--reason", "signed")
    fleet.until(20, "the signed one judges", lambda: set(fleet.in_use().values()) == {fresh})


def admin_args(fleet, *args):
    pki = fleet.dir / "pki/operator/admin/root"
    return [fleet.bin / "ripsctl", "--server", f"127.0.0.1:{fleet.port}", "--ca", pki / "ca.pem",
            "--cert", pki / "cert.pem", "--key", pki / "key.pem", *args]


SCENARIOS = [reaches_all_robots_stage_by_stage, stops_by_itself_when_a_robot_is_degraded,
             stops_by_itself_when_rules_raise_a_level_and_goes_back,
             goes_on_after_the_server_was_killed, a_shadow_reports_and_judges_nothing,
             only_signed_bundles_come_into_force]


def main():
    if len(sys.argv) < 3:
        print("\n".join(scenario.__name__ for scenario in SCENARIOS))
        return 0
    scenario = next(each for each in SCENARIOS if each.__name__ == sys.argv[2])
    parent = pathlib.Path(sys.argv[1]).resolve().parent / "scenarios"
    parent.mkdir(exist_ok=True)
    directory = pathlib.Path(tempfile.mkdtemp(prefix=scenario.__name__ + ".", dir=parent))
    fleet = ManyRobots(sys.argv[1], directory)

    def play(fleet):
        fleet.prepare()
        scenario(fleet)

    code = perform(scenario.__name__, play, fleet)
    if code == 0:
        shutil.rmtree(directory)
    return code


if __name__ == "__main__":
    sys.exit(main())
