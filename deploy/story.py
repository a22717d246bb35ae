"""The demo: the story of the RIPS paper ("Experimental Validation") on one machine, as a timeline."""

import argparse
import datetime
import pathlib
import shutil
import signal
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests/support"))
from fleet import Failed, Fleet, log_time, unix_ns  # noqa: E402

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

COLOURS = {"attack": "\033[31m", "rips": "\033[33m", "operator": "\033[36m", "robot": "\033[32m"}


def say(who, text, at_ns=None):
    """One line of the timeline: wall time, who, what."""
    at = (at_ns or time.time_ns()) / 1e9
    clock = datetime.datetime.fromtimestamp(at).strftime("%H:%M:%S.%f")[:-3]
    if sys.stdout.isatty():
        print(f"  {clock}  {COLOURS.get(who, '')}{who:<9}\033[0m {text}", flush=True)
    else:
        print(f"  {clock}  {who:<9} {text}", flush=True)


def title(text):
    print(f"\n{text}", flush=True)


class Story:
    """What happens to one robot. `about` begins its lines, if there are others; `patience` is how
    many times as long as alone on the machine things may take."""

    def __init__(self, fleet, about="", patience=1):
        self.fleet = fleet
        self.about = about
        self.patience = patience
        self.latencies = []  # (what, alert ms, command ms, read back ms)
        self.seen_alerts = 0

    def say(self, who, text, at_ns=None):
        say(who, self.about + text, at_ns)

    # ------------------------------------------------------------------------- what is seen

    def new_alerts(self):
        alerts = self.fleet.alerts()
        fresh = alerts[self.seen_alerts:]
        self.seen_alerts = len(alerts)
        return fresh

    def tell_alerts(self):
        fresh = self.new_alerts()
        for alert in fresh:
            rule = "" if alert["rule"] == "(rips)" else f"   [rule {alert['rule']}]"
            about = f" ({alert['event']})" if alert["event"] else ""
            self.say("rips", f"ALERT {alert['severity']}: {alert['text']}{about}{rule}",
                     unix_ns(alert["time"]))
        return fresh

    def receipts(self, start):
        """Times (ns) of the actuator's first ACKNOWLEDGED and VERIFIED receipt after `start`."""
        times = {}
        for _, text in list(self.fleet.actuator.lines):
            at = log_time(text)
            if at is None or at < start or " receipt " not in text:
                continue
            for stage in ("ACKNOWLEDGED", "VERIFIED"):
                if f"stage={stage.lower()} " in text:
                    times.setdefault(stage, at)
        return times

    def camera_hz(self, wanted, seconds):
        """Waits until the camera's rate is as wanted(hz)."""
        seconds *= self.patience
        deadline = time.monotonic() + seconds
        count = len(self.camera.events())
        while time.monotonic() < deadline:
            rates = [event["hz"] for event in self.camera.events()[count:]
                     if event.get("event") == "rate"]
            if rates and wanted(rates[-1]):
                return rates[-1]
            time.sleep(0.05)
        last = f"{rates[-1]:.1f} Hz" if rates else "no measurement"
        raise Failed(f"camera rate not as expected within {seconds} s: {last}")

    def tell_robot(self, level, camera_on):
        hz = self.camera_hz((lambda rate: rate > 12) if camera_on else (lambda rate: rate == 0), 6)
        mode = self.fleet.mode()
        wanted = "__DEFAULT__" if level == "DEFAULT" else level
        if mode["mode"] != wanted:
            raise Failed(f"the mode read back is {mode['mode']}, not {wanted}")
        off = [part["part"] for part in mode["parts"] if part["state"] != "active"]
        self.say("robot", f"mode read back: {mode['mode']}; camera {hz:.1f} Hz; "
                          f"off: {', '.join(off) if off else 'nothing'}")

    def decision(self, level, start_ns, seconds):
        """Waits until `level` is verified and tells the decision."""
        self.fleet.wait_level(level, seconds * self.patience)
        alerts = self.tell_alerts()
        decisions = [each for each in self.fleet.history()
                     if not each["refused"] and unix_ns(each["time"]) >= start_ns]
        if not decisions or decisions[-1]["to"] != level:
            raise Failed(f"no decision for {level} is recorded")
        last = decisions[-1]
        self.say("rips", f"level {last['from']} -> {last['to']}   [{last['cause']}, decision "
                         f"{last['decision_id']}]", unix_ns(last["time"]))
        return alerts, last

    def attack(self, what, first_ns, level):
        alerts, decision = self.decision(level, first_ns, 15)
        times = self.receipts(first_ns)
        caused = [unix_ns(alert["time"]) for alert in alerts if alert["rule"] != "(rips)"]
        if not caused or "ACKNOWLEDGED" not in times or "VERIFIED" not in times:
            raise Failed(f"{what}: alert, command or read-back is missing from the records")
        self.latencies.append((what, *[(at - first_ns) / 1e6 for at in
                                       (caused[0], times["ACKNOWLEDGED"], times["VERIFIED"])]))
        return decision

    # ----------------------------------------------------------------------------- the story

    def normal(self):
        title("1. Normal operation")
        self.fleet.prepare()
        self.fleet.robot = self.fleet.start_robot()
        self.say("robot", "five nodes on DDS: camera, lidar, base, navigator, safety "
                          "(System Modes)")
        self.fleet.server = self.fleet.start_server()
        self.say("rips", f"policy server on 127.0.0.1:{self.fleet.port}, mutual TLS; policy "
                         f"`{self.fleet.bundle}`")
        self.fleet.sensor = self.fleet.start_agent("sensor")
        self.fleet.actuator = self.fleet.start_agent("actuator")
        self.camera = self.fleet.start_camera_probe()
        self.say("rips", "sensor and mode actuator attached; a new actuator holds the robot at its "
                         "fail-safe level until the server's lease and evidence have held for 10 s")
        self.fleet.wait_level("DEFAULT", 40)
        self.tell_alerts()
        graph = self.fleet.query("robot", "graph", "r1")
        nodes = [node["name"] for node in graph["nodes"]]
        self.say("rips", f"level DEFAULT, verified; sees {len(nodes)} nodes and "
                         f"{len(graph['topics'])} topics")
        self.tell_robot("DEFAULT", camera_on=True)

    def unknown_node(self):
        title("2. An unknown node joins (ALERT, soft)")
        self.join()

    def join(self):
        self.spy = self.fleet.start_intruder("unknown-node")
        _, event = self.spy.wait_for(
            lambda line: '"announced"' in line and line, 10 * self.patience, "the intruder joins")
        first_ns = next(e["unix_ns"] for e in self.spy.events() if e["event"] == "announced")
        self.say("attack", "/intruder joins and asks for the camera's images", first_ns)
        self.attack("an unknown node joins", first_ns, "ALERT")
        self.tell_robot("ALERT", camera_on=False)

    def rogue(self):
        title("3. A second publisher drives (COMPROMISED, hard)")
        self.drive()

    def drive(self):
        self.driver = self.fleet.start_intruder("rogue-cmd-vel", "--node", "/intruder_driver")
        self.driver.wait_for(lambda line: '"first_sample"' in line, 10 * self.patience,
                             "the intruder drives")
        first_ns = next(e["unix_ns"] for e in self.driver.events() if e["event"] == "first_sample")
        self.say("attack", "/intruder_driver publishes on /cmd_vel", first_ns)
        self.attack("a second cmd_vel publisher", first_ns, "COMPROMISED")
        self.tell_robot("COMPROMISED", camera_on=False)

    def gone(self):
        title("4. The intruders leave; a hard level stays")
        self.driver.kill()
        self.spy.kill()
        self.say("attack", "both intruders are gone")
        time.sleep(7)  # longer than soft_hold: nothing may happen
        self.tell_alerts()
        status = self.fleet.level()
        if status["decided_level"] != "COMPROMISED":
            raise Failed(f"the level went to {status['decided_level']} without a person")
        self.say("rips", "level still COMPROMISED: only a person may lower it")

    def release(self):
        title("5. The operator brings the robot back, one step")
        self.order("lower", "ALERT", "rogue publisher removed, robot checked on site")
        self.tell_robot("ALERT", camera_on=False)

    def order(self, verb, level, reason):
        """The operator raises or lowers the level; waits until that is verified."""
        start_ns = time.time_ns()
        args = ["level", verb, self.fleet.robot_id, "--to", level, "--reason", reason]
        self.say("operator", "$ ripsctl " + " ".join(f'"{a}"' if " " in a else a for a in args))
        _, out, _ = self.fleet.ripsctl(*args)
        for line in out.strip().splitlines():
            self.say("operator", f"  {line}")
        self.decision(level, start_ns, 15)

    def soft_return(self):
        title("6. Quiet: a rule may lower a soft level after soft_hold (5 s)")
        start_ns = time.time_ns()
        self.decision("DEFAULT", start_ns - 10**9, 20)
        self.tell_robot("DEFAULT", camera_on=True)

    def replays(self):
        title("7. What led to each alert is on record")
        grave = [alert for alert in self.fleet.alerts()
                 if alert["severity"] in ("high", "critical") and alert["rule"] != "(rips)"]
        for alert in grave:
            self.say("operator", f"$ ripsctl alert recording {alert['id'][:8]} --out alert.rips")
            result, path = self.fleet.replay(alert)
            same = [each for each in result["recorded"] if each["id"] == alert["id"]]
            if not same or same[0]["event"] is None:
                raise Failed(f"the recording {path} does not replay to `{alert['text']}`")
            events = result["events"]
            self.say("rips", f"replayed: {events['message']} messages, {events['graph']} changes "
                             f"of the graph; rule {alert['rule']} raises the same alert")

    def summary(self, started):
        title("What it took")
        self.tell_latencies()
        decisions = [each for each in self.fleet.history() if not each["refused"]]
        print(f"  {len(decisions)} decisions, all verified by reading the mode back; "
              f"{len(self.fleet.alerts())} alerts; {time.monotonic() - started:.0f} s")
        unverified = [each for each in decisions if each["stage"] != "verified"]
        if unverified:
            raise Failed(f"decision {unverified[0]['decision_id']} was never verified")

    def tell_latencies(self):
        print("                                     sample to alert   to command   to mode read back")
        for what, alert, command, verified in self.latencies:
            print(f"  {what:<32} {alert:>13.1f} ms {command:>9.1f} ms {verified:>14.1f} ms")
        print("  (the robot itself takes 150 ms to change its mode; an unknown node is judged when"
              "\n   discovery has been quiet for 20 ms)")


def options_of(description):
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--binaries", required=True)
    parser.add_argument("--directory", required=True)
    parser.add_argument("--keep", action="store_true")
    options = parser.parse_args()
    options.directory = pathlib.Path(options.directory)
    if options.directory.exists():
        shutil.rmtree(options.directory)
    return options


def end_on_signals():
    """So that what is to be done at the end is done."""
    def end(number, _):
        sys.exit(128 + number)

    for number in SIGNALS:
        signal.signal(number, end)


def tell(steps, options, world, keep):
    """Does one step after the other, with --keep then keep(world), which waits for a signal;
    whatever happens, stops what was started. Returns the exit code."""
    end_on_signals()
    kept = False
    try:
        for step in steps:
            step()
        kept = options.keep
        if kept:
            keep(world)
    except Failed as failed:
        print(f"\nFAILED: {failed}\n        logs: {options.directory}", file=sys.stderr)
        return 1
    except SystemExit:
        if not kept:
            raise
    finally:
        for number in SIGNALS:  # the rest is stopped, too
            signal.signal(number, signal.SIG_IGN)
        world.stop()
    print("\nStopped." if kept else "\nThe demo passed.")
    return 0


def main():
    options = options_of(__doc__)
    fleet = Fleet(options.binaries, options.directory)
    story = Story(fleet)
    started = time.monotonic()
    return tell((story.normal, story.unknown_node, story.rogue, story.gone, story.release,
                 story.soft_return, story.replays, lambda: story.summary(started)), options, fleet,
                keep)


def keep(fleet):
    pki = fleet.dir / "pki/operator/operator/alice"
    print(f"""
Left running. In another terminal:

  export CYCLONEDDS_URI='{fleet.env["CYCLONEDDS_URI"]}'
  export RIPSCTL_SERVER=127.0.0.1:{fleet.port} RIPSCTL_CA={pki}/ca.pem \\
         RIPSCTL_CERT={pki}/cert.pem RIPSCTL_KEY={pki}/key.pem
  cd {fleet.bin}
  ./ripsctl robot list
  ./ripsctl robot graph r1
  ./ripsctl alert watch
  ./ripsctl level history r1
  ./ripsctl level raise r1 --to HALT --reason "trying it"
  ./ripsctl level lower r1 --to DEFAULT --reason "tried it" --wait
  ./robot_sim intruder --domain {fleet.domain} --mode rogue-cmd-vel

Ctrl-C here stops everything.""", flush=True)
    while True:
        time.sleep(1)


if __name__ == "__main__":
    sys.exit(main())
