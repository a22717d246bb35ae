"""The paper's experiment with every decision made by RIPS: real processes, real DDS."""

import argparse
import json
import pathlib
import shutil
import signal
import statistics
import subprocess
import sys
import threading
import time

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "tests/support"))
from fleet import SOURCE, Failed, Fleet, log_time, unix_ns  # noqa: E402
from recording import Floor, Level, Run  # noqa: E402
from timelines import TIMELINES  # noqa: E402

# Debian's, which has the plotting library.
PLOTTER = ["/usr/bin/python3", "-B", HERE / "figure.py"]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# From when the robot is at DEFAULT until its seconds begin, and how much of that is looked at (in
# its seconds): by then the camera has its rate and the map is open.
SETTLE_S = 2
BEFORE_S = 1
# What robot_sim calls it, its node, and what it does and stops doing.
ATTACKS = {"spy": ("unknown-node", "/intruder", "an unknown node reads the camera",
                   "the unknown node leaves"),
           "driver": ("rogue-cmd-vel", "/intruder_driver", "a second node drives",
                      "the second driver leaves")}


class Experiment(Fleet):
    """One robot and its RIPS, for one run of a timeline."""

    def __init__(self, binaries, directory, speed):
        super().__init__(binaries, directory, bundle="experiment", floor_hold="1s")
        self.speed = speed
        self.smh = HERE / "smh.yaml"
        self.levels = ["DEFAULT", "ALERT", "COMPROMISED"]
        self.intruders = {}
        self.causes = []   # (unix ns, detail, whether it is an attack)
        self.people = []   # unix ns
        self.threads = []

    def begin(self):
        self.prepare()
        self.robot = self.start_robot("--floor", HERE / "floor.yaml", "--speed", self.speed,
                                      "--image-width", 80, "--image-height", 60,
                                      "--control", self.dir / "control")
        self.start_server()
        self.start_agent("sensor")
        self.actuator = self.start_agent("actuator")
        self.observer = self.start("observer", self.bin / "robot_sim", "observe", "--domain",
                                   self.domain)
        self.observer.wait_for(lambda line: '"ready"' in line, 10, "the observer starts")
        self.wait_level("DEFAULT", 40)
        self.observer.wait_for(lambda line: '"frame"' in line, 10, "a picture comes")
        time.sleep(SETTLE_S)

    # ------------------------------------------------------------------------------- actions

    def tell_robot(self, line):
        with open(self.dir / "control", "w", encoding="utf-8") as pipe:
            pipe.write(line + "\n")

    def act(self, verb, *args):
        now_ns = time.time_ns()
        if verb == "go":
            self.tell_robot(f"go {args[0]}")
        elif verb == "person":
            self.tell_robot("person")
            self.people.append(now_ns)
            self.causes.append((now_ns, "a person crosses", False))
        elif verb == "lower":
            thread = threading.Thread(target=self.lower, args=args, daemon=True)
            thread.start()
            self.threads.append(thread)
            self.causes.append((now_ns, f"alice lowers the level to {args[0]}", False))
        elif args[0] == "comes":
            mode, node, what, _ = ATTACKS[verb]
            self.intruders[verb] = self.start_intruder(mode, "--node", node)
            thread = threading.Thread(target=self.note_attack, args=(verb, what), daemon=True)
            thread.start()
            self.threads.append(thread)
        else:
            self.intruders.pop(verb).kill()
            self.causes.append((now_ns, ATTACKS[verb][3], False))

    def note_attack(self, verb, what):
        """From when it does harm: a reader when it is announced, a driver when it drives."""
        event = "announced" if verb == "spy" else "first_sample"
        intruder = self.intruders[verb]
        intruder.wait_for(lambda line: f'"{event}"' in line, 10, what)
        at_ns = next(e["unix_ns"] for e in intruder.events() if e["event"] == event)
        self.causes.append((at_ns, what, True))

    def lower(self, level, reason):
        self.ripsctl("level", "lower", "r1", "--to", level, "--reason", reason)

    def play(self, timeline):
        """Does what the timeline says, and gives what came of it."""
        start_ns = time.time_ns()
        for at, *action in timeline["actions"]:
            time.sleep(max(0, start_ns / 1e9 + at / self.speed - time.time()))
            self.act(*action)
        end = start_ns / 1e9 + timeline["seconds"] / self.speed
        time.sleep(max(0, end - time.time()))
        for thread in self.threads:
            thread.join(10)
        self.wait_level(timeline["levels"][-1][0], 10)
        return self.collect(start_ns, timeline["seconds"])

    # ------------------------------------------------------------------------ what came of it

    def collect(self, start_ns, seconds):
        def at(ns):
            return (ns - start_ns) / 1e9 * self.speed

        run = Run(seconds=seconds, speed=self.speed)
        for event in self.observer.events():
            t = at(event.get("unix_ns", 0))
            if not -BEFORE_S < t <= seconds:
                continue
            if event["event"] == "frame":
                run.frames.append(t)
            elif event["event"] == "cells":
                run.cells.append((t, event["free"], event["occupied"]))
            elif event["event"] == "pose":
                run.poses.append((t, event["x"], event["y"], event["speed"]))
            elif event["event"] == "twist":
                run.twists.append(t)
        for series in (run.frames, run.cells, run.poses, run.twists):
            series.sort()
        run.person = [at(ns) for ns in self.people]
        read_back = self.read_back_times()
        decisions = [each for each in self.history()
                     if not each["refused"] and unix_ns(each["time"]) >= start_ns]
        for each in decisions:
            ordered_ns = unix_ns(each["time"])
            confirmed_ns = read_back.get(each["decision_id"])
            if confirmed_ns is None:
                raise Failed(f"decision {each['decision_id']} was never read back")
            run.levels.append(Level(each["to"], each["cause"], at(ordered_ns), at(confirmed_ns)))
            who = "operator alice" if each["cause"].startswith("operator") else each["cause"]
            run.events += [(at(ordered_ns), "ordered", f"{each['to']} ({who})"),
                           (at(confirmed_ns), "confirmed", each["to"])]
        alerts = [(unix_ns(alert["time"]), alert["text"]) for alert in self.alerts()
                  if alert["rule"] != "(rips)" and unix_ns(alert["time"]) >= start_ns]
        run.events += [(at(ns), "detected", text) for ns, text in alerts]
        run.events += [(at(ns), "cause", text) for ns, text, _ in self.causes]
        run.events.sort()
        for ns, _, attack in self.causes:
            decided = [each for each in decisions if unix_ns(each["time"]) >= ns]
            if attack and decided:
                times = (min((each for each, _ in alerts if each >= ns), default=None),
                         unix_ns(decided[0]["time"]), read_back[decided[0]["decision_id"]])
                if times[0] is not None:
                    run.latencies.append([(each - ns) / 1e6 for each in times])
        return run

    def read_back_times(self):
        """When the actuator had read each decision's mode back from the robot: decision id -> ns."""
        out = {}
        for _, text in list(self.actuator.lines):
            at = log_time(text)
            if at is not None and " receipt " in text and "stage=verified" in text:
                out.setdefault(text.partition(" decision_id=")[2].split(" ")[0], at)
        return out


def clear(directory):
    """Removes what an earlier run has left, and nothing else."""
    mark = directory / "made-by-deploy-experiment"
    if directory.exists():
        if not mark.exists():
            raise Failed(f"{directory} is not of an earlier experiment; choose another --out")
        shutil.rmtree(directory)
    directory.mkdir(parents=True)
    mark.touch()


def run_once(binaries, directory, name, speed, csv_path=None):
    """One run of a timeline: (Run, what is not as it must be)."""
    clear(directory)
    experiment = Experiment(binaries, directory, speed)
    try:
        experiment.begin()
        run = experiment.play(TIMELINES[name])
    finally:
        experiment.stop()
    if csv_path:
        run.write_csv(csv_path)
    return run, run.problems(Floor(), TIMELINES[name]["levels"])


# ------------------------------------------------------------------------------------- report

def percentile(values, share):
    values = sorted(values)
    return values[min(len(values) - 1, int(share * len(values)))]


def tell_latencies(runs, speed):
    rows = [row for run in runs for row in run.latencies]
    if not rows:
        return
    print(f"\nFrom an attack's first sign on DDS, over {len(rows)} attacks in {len(runs)} runs:")
    for i, what in enumerate(("RIPS's alert", "level decided and ordered", "mode read back")):
        times = [row[i] for row in rows]
        print(f"  {what:<27} p50 {statistics.median(times):6.1f} ms   "
              f"p95 {percentile(times, 0.95):6.1f} ms   longest {max(times):6.1f} ms")
    print(f"  (the robot's own change of mode takes {150 / speed:g} ms of these, at this speed)")


def tell_table(run, floor):
    """The paper's numbers beside ours, of the main timeline."""
    closed = min(floor.counts(True, False))
    levels = [f"{level.name} {level.ordered:.1f}" for level in run.levels]
    rows = [("cells of the map, free", "1662", f"{len(floor.free)}"),
            ("  occupied", "39720", f"{floor.cells - len(floor.free)}"),
            ("  free with the zone closed", "fewer", f"{closed}"),
            ("  occupied with the zone closed", "fewer (see EXPERIMENT.md)",
             f"{floor.cells - closed}"),
            ("camera before the attack, Hz", "its maximum", f"{run.hz(run.levels[0].ordered - 1):.0f}"),
            ("camera from ALERT on, Hz", "0", f"{run.hz(run.levels[0].ordered + 3):.0f}"),
            ("levels, s", "ALERT 12, COMPROMISED 40,", ", ".join(levels[:2]) + ","),
            ("", "ALERT 47, DEFAULT 70", ", ".join(levels[2:]))]
    print(f"\n  {'':<34}{'paper':<28}here")
    for what, paper, ours in rows:
        print(f"  {what:<34}{paper:<28}{ours}")


def draw(csv_path, name, speed, out):
    title = TIMELINES[name]["title"] + (f", at {speed:g} times the speed" if speed != 1 else "")
    done = subprocess.run([*PLOTTER, csv_path, "--title", title, "--out", out / name],
                          capture_output=True, text=True)
    if done.returncode != 0:
        raise Failed(f"the figure was not drawn: {done.stderr.strip()}")


def end_once(number, _frame):
    """Ends everything on the first signal; those that follow must not leave half of it running."""
    for each in SIGNALS:
        signal.signal(each, signal.SIG_IGN)
    sys.exit(128 + number)


def main():
    parser = argparse.ArgumentParser(prog="deploy/experiment", description=__doc__)
    parser.add_argument("--binaries", required=True, help=argparse.SUPPRESS)
    parser.add_argument("--timeline", choices=[*TIMELINES, "all"], default="all")
    parser.add_argument("--speed", type=float, default=10,
                        help="the robot's seconds in one of ours, 1 to 20 (10)")
    parser.add_argument("--runs", type=int, default=1, help="of each timeline (1)")
    parser.add_argument("--out", type=pathlib.Path, default=SOURCE / "build/experiment",
                        help="directory for CSV and figures (build/experiment)")
    options = parser.parse_args()
    if not 1 <= options.speed <= 20 or options.runs < 1:
        parser.error("--speed is 1 to 20, --runs 1 or more")
    for each in SIGNALS:
        signal.signal(each, end_once)
    names = list(TIMELINES) if options.timeline == "all" else [options.timeline]
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "latencies.json").touch()
    except OSError as error:
        print(f"error: cannot write to {options.out}: {error.strerror}", file=sys.stderr)
        return 2
    floor = Floor()
    runs, failed = {name: [] for name in names}, 0
    try:
        for name in names:
            timeline = TIMELINES[name]
            print(f"==> {timeline['title']}: {timeline['seconds']} s at {options.speed:g} times the "
                  "speed", flush=True)
            for number in range(1, options.runs + 1):
                csv_path = options.out / (f"{name}.csv" if number == 1 else f"{name}-{number}.csv")
                run, problems = run_once(options.binaries, options.out / "run", name,
                                         options.speed, csv_path)
                runs[name].append(run)
                failed += bool(problems)
                decided = ", ".join(f"{level.name} at {level.ordered:.1f} s"
                                    for level in run.levels)
                print(f"    {number}/{options.runs}  {decided}", flush=True)
                for problem in problems:
                    print(f"         NOT AS IT MUST BE: {problem}", flush=True)
                if problems and options.speed > 1:
                    print("         (a busy machine makes a robot stutter that runs so fast: try a "
                          "lower --speed)", flush=True)
            draw(options.out / f"{name}.csv", name, options.speed, options.out)
    except Failed as error:
        print(f"error: {error}\n       logs: {options.out}/run/*.log", file=sys.stderr)
        return 1
    tell_latencies([run for each in runs.values() for run in each], options.speed)
    if "main" in runs:
        tell_table(runs["main"][0], floor)
    (options.out / "latencies.json").write_text(json.dumps(
        {name: [run.latencies for run in each] for name, each in runs.items()}), encoding="utf-8")
    total = sum(len(each) for each in runs.values())
    print(f"\n{total - failed} of {total} runs were as they must be (deploy/EXPERIMENT.md says what "
          f"that is).\nCSV and figures: {options.out}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
