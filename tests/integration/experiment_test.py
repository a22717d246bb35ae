"""The paper's experiment, shortened, and that its checks find what is wrong.

    experiment_test.py                     names of the scenarios
    experiment_test.py BINARIES SCENARIO   plays one
"""

import csv
import os
import pathlib
import shutil
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "deploy/paper"))
sys.path.insert(0, str(HERE.parents[0] / "support"))
from fleet import Failed, check  # noqa: E402
from experiment import Experiment  # noqa: E402
from recording import Floor, Level, Run, steps  # noqa: E402
from timelines import CALM, SPY, TIMELINES  # noqa: E402

SPEED = 4
SCENARIOS = {}


def scenario(function):
    SCENARIOS[function.__name__] = function
    return function


@scenario
def short_timeline(binaries, directory):
    """An unauthorised node reads the camera for a while; the robot drives round the closed zone."""
    experiment = Experiment(binaries, directory, SPEED)
    try:
        experiment.begin()
        run = experiment.play(TIMELINES["short"])
    except Failed:
        for process in experiment.processes:
            print(f"--- {process.name}", *[text for _, text in process.lines[-10:]], sep="\n")
        raise
    finally:
        experiment.stop()
    problems = run.problems(Floor(), TIMELINES["short"]["levels"])
    check(not problems, "; ".join(problems))
    check(len(run.latencies) == 1, f"one attack has one latency: {run.latencies}")
    path = pathlib.Path(directory) / "short.csv"
    run.write_csv(path)
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    got = [row["event"] for row in rows if row["event"]]
    for event in ("cause", "detected", "ordered", "confirmed", "last_frame", "first_frame"):
        check(event in got, f"the CSV has no row for `{event}`: {got}")
    times = [float(row["t"]) for row in rows]
    check(times == sorted(times), "the CSV is not in order of time")


def as_it_should_be(floor):
    """A run of an ALERT from 10 s to 20 s, of which nothing is wrong."""
    run = Run(seconds=30)
    run.levels = [Level("ALERT", f"rule experiment.rul:{SPY}", 10, 10.5),
                  Level("COMPROMISED", "rule unknown_driver", 12, 12.5),
                  Level("ALERT", "operator alice: checked", 15, 15.5),
                  Level("DEFAULT", f"rule experiment.rul:{CALM}", 20, 20.5)]
    run.frames = [t / 30 for t in range(-30, 900) if not 10.4 < t / 30 < 20.4]
    closed, = floor.counts(True, False)
    opened, = floor.counts(False, False)
    run.cells = [(t / 2, *((closed, floor.cells - closed) if 10.4 < t / 2 < 20.4
                           else (opened, floor.cells - opened))) for t in range(60)]
    run.poses = [(t, 1.0, 5.2, 0.0 if 12.4 < t < 15.05 else 0.3) for t in steps(0, 30)]
    return run


EXPECTED = [("ALERT", SPY), ("COMPROMISED", "unknown_driver"), ("ALERT", "operator"),
            ("DEFAULT", CALM)]


@scenario
def checks_find_what_is_wrong(_binaries, _directory):
    floor = Floor()
    check(len(floor.free) == 1_662 and floor.cells == 41_382, "the floor is not the paper's")
    check(floor.counts(True, False) == {1_402}, "the closed zone is not as drawn")
    check(1_402 - 24 in floor.counts(True, True), "a person on the detour covers 24 cells")
    right = as_it_should_be(floor)
    check(right.problems(floor, EXPECTED) == [],
          f"nothing is wrong: {right.problems(floor, EXPECTED)}")

    def wrong(what, change, says):
        run = as_it_should_be(floor)
        change(run)
        problems = run.problems(floor, EXPECTED)
        check(any(says in problem for problem in problems), f"{what}: {problems}")

    def slow_camera(run):
        run.frames = [t for i, t in enumerate(run.frames) if t > 9 or i % 2]

    def one_picture(run):
        run.frames = sorted(run.frames + [13.0])

    def stays_dark(run):
        run.frames = [t for t in run.frames if t < 20]

    def drives_in(run):
        x, y = min(floor.zone)
        run.poses[140] = (14.0, (x + 0.5) * floor.cell_m, (y + 0.5) * floor.cell_m, 0.0)

    def creeps(run):
        run.poses[130] = (13.0, 1.01, 5.2, 0.0)

    def another_map(run):
        run.cells[30] = (15.0, 1_403, floor.cells - 1_403)

    def one_cell_lost(run):
        run.cells[2] = (1.0, 1_662, floor.cells - 1_663)

    def level_without_cause(run):
        run.levels[2].cause = "adopted"

    wrong("a slow camera", slow_camera, "before the first attack")
    wrong("a picture while it is off", one_picture, "a picture came at 13.00 s")
    wrong("a camera that does not come back", stays_dark, "the camera is not back")
    wrong("a robot in the zone", drives_in, "in the closed zone at 14.0 s")
    wrong("a robot that creeps", creeps, "moved while it was stopped")
    wrong("a robot without a pose", lambda run: run.poses.clear(), "no pose was seen")
    wrong("a cell too many", another_map, "not [1402] free")
    wrong("a cell that is neither", one_cell_lost, "at 1.0 s the map had")
    wrong("a level without a cause", level_without_cause, "the levels are")
    wrong("a level that is missing", lambda run: run.levels.pop(), "the levels are")


def main():
    if len(sys.argv) == 1:
        print("\n".join(SCENARIOS))
        return 0
    if len(sys.argv) != 3 or sys.argv[2] not in SCENARIOS:
        print(__doc__, file=sys.stderr)
        return 2
    name = sys.argv[2]
    if os.environ.get("RIPS_SANITIZE"):
        print("skipped: times are those of what ships")
        return 77
    directory = tempfile.mkdtemp(prefix=f"{name}.")
    try:
        SCENARIOS[name](sys.argv[1], directory)
    except Failed as failed:
        print(f"FAILED {name}: {failed}")
        return 1
    shutil.rmtree(directory, ignore_errors=True)
    print(f"passed {name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
