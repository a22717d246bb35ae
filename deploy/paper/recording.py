"""What came of one run: everything with its time in the robot's seconds, and whether it is as the
paper says."""

import bisect
import csv
import dataclasses
import functools
import math
import pathlib

import yaml

HERE = pathlib.Path(__file__).resolve().parent
CSV_COLUMNS = ["t", "hz", "free", "occupied", "x", "y", "speed", "cmd_hz", "decided", "confirmed",
               "event", "detail"]
STEP_S = 0.1
HZ_WINDOW_S = 1.0
FULL_HZ = 30
# What the experiment must show, in the robot's seconds.
HZ_TOLERANCE = 0.1
# The rate before an attack is that of a second, and at a higher speed of this much of our time: a
# host's threads are not more punctual.
HOST_WINDOW_S = 0.3
DARK_AFTER_S = 1.5
LIGHT_WITHIN_S = 3
MAP_PERIOD_S = 0.5
PERSON_S = 6
STILL_M = 0.001


class Floor:
    """The same file as the robot's, counted anew."""

    def __init__(self, path=HERE / "floor.yaml"):
        plan = yaml.safe_load(path.read_text(encoding="utf-8"))
        self.cells = plan["width"] * plan["height"]
        self.cell_m = plan["cell_mm"] / 1_000
        self.free = set()
        for text in plan["free"]:
            self.free |= self._cells(text)
        self.zone = self._cells(plan["keep_out"])
        person = plan["person"]
        (x0, y0), (x1, y1) = ([int(n) for n in person[end].split()] for end in ("from", "to"))
        steps = 10 * max(abs(x1 - x0), abs(y1 - y0))
        low, size = person["cells"] // 2, person["cells"]
        self.bodies = []
        for x, y in sorted({(round(x0 + (x1 - x0) * i / steps), round(y0 + (y1 - y0) * i / steps))
                            for i in range(steps + 1)}):
            self.bodies.append({(cx, cy) for cx in range(x - low, x - low + size)
                                for cy in range(y - low, y - low + size)})

    @staticmethod
    def _cells(text):
        x0, y0, x1, y1 = (int(number) for number in text.split())
        return {(x, y) for x in range(x0, x1 + 1) for y in range(y0, y1 + 1)}

    @functools.cache
    def counts(self, keep_out, person):
        """Numbers of free cells that there may be."""
        free = self.free - self.zone if keep_out else self.free
        return {len(free)} | ({len(free - body) for body in self.bodies} if person else set())

    def in_zone(self, x, y):
        return (int(x / self.cell_m), int(y / self.cell_m)) in self.zone


@dataclasses.dataclass
class Level:
    """A decision, and when it was carried out."""
    name: str
    cause: str          # as in the history
    ordered: float
    confirmed: float    # the mode was read back from the robot


@dataclasses.dataclass
class Run:
    """Times in the robot's seconds from the beginning; lists in order of time."""
    frames: list = dataclasses.field(default_factory=list)
    cells: list = dataclasses.field(default_factory=list)    # (t, free, occupied)
    poses: list = dataclasses.field(default_factory=list)    # (t, x, y, speed)
    twists: list = dataclasses.field(default_factory=list)
    events: list = dataclasses.field(default_factory=list)   # (t, event, detail)
    levels: list = dataclasses.field(default_factory=list)
    person: list = dataclasses.field(default_factory=list)   # when the person began to walk
    # Of each attack, in real milliseconds after it: detected, ordered, confirmed.
    latencies: list = dataclasses.field(default_factory=list)
    seconds: float = 0
    speed: float = 1

    def hz(self, t, times=None, window=HZ_WINDOW_S):
        times = self.frames if times is None else times
        return (bisect.bisect_right(times, t) - bisect.bisect_right(times, t - window)) / window

    def level_at(self, t, when):
        name = "DEFAULT"
        for level in self.levels:
            if getattr(level, when) <= t:
                name = level.name
        return name

    def camera_offs(self):
        """(ordered off, ordered on again or the end) of each time that the camera was off."""
        out = []
        for level in self.levels:
            if level.name != "DEFAULT" and (not out or out[-1][1] is not None):
                out.append((level.ordered, None))
            elif level.name == "DEFAULT" and out and out[-1][1] is None:
                out[-1] = (out[-1][0], level.ordered)
        return [(off, self.seconds if on is None else on) for off, on in out]

    def intervals(self, names):
        """From when one of these levels was confirmed until another was ordered."""
        out = []
        for i, level in enumerate(self.levels):
            until = self.levels[i + 1].ordered if i + 1 < len(self.levels) else self.seconds
            if level.name in names:
                out.append((level.confirmed, until))
        return out

    # -------------------------------------------------------------------------------- checks

    def problems(self, floor, expected):
        """What is not as it must be, as texts; `expected` as `levels` of a timeline."""
        out = []
        got = [(level.name, level.cause) for level in self.levels]
        if len(got) != len(expected) or any(name != wanted or who not in cause for (name, cause), (
                wanted, who) in zip(got, expected)):
            return [f"the levels are {got}, not {expected}"]
        out += self._camera_problems()
        out += self._cell_problems(floor)
        for begin, end in self.intervals({"ALERT", "COMPROMISED"}):
            inside = [t for t, x, y, _ in self.poses if begin <= t <= end and floor.in_zone(x, y)]
            if inside:
                out.append(f"the robot was in the closed zone at {inside[0]:.1f} s")
        for begin, end in self.intervals({"COMPROMISED"}):
            still = [(x, y, speed) for t, x, y, speed in self.poses if begin <= t <= end]
            if not still:
                out.append("no pose was seen while the robot was stopped")
            elif any(speed > 0 or math.dist(still[0][:2], (x, y)) > STILL_M
                     for x, y, speed in still):
                out.append(f"the robot moved while it was stopped, from {begin:.1f} s")
        return out

    def _camera_problems(self):
        out = []
        offs = self.camera_offs()
        calm_until = offs[0][0] if offs else self.seconds
        window = max(HZ_WINDOW_S, HOST_WINDOW_S * self.speed)
        rates = [self.hz(t, window=window) for t in steps(window, calm_until - 0.2)]
        off_by = [rate for rate in rates if abs(rate - FULL_HZ) > HZ_TOLERANCE * FULL_HZ]
        if off_by:
            out.append(f"the camera had {off_by[0]:.0f} Hz before the first attack")
        for off, on in offs:
            late = [t for t in self.frames if off + DARK_AFTER_S < t < on]
            if late:
                out.append(f"a picture came at {late[0]:.2f} s although the camera was ordered off "
                           f"at {off:.2f} s")
            if on < self.seconds and not any(self.hz(t) >= (1 - HZ_TOLERANCE) * FULL_HZ
                                             for t in steps(on, on + LIGHT_WITHIN_S)):
                out.append(f"{LIGHT_WITHIN_S} s after {on:.1f} s the camera is not back")
        return out

    def _cell_problems(self, floor):
        before = ["DEFAULT", *(level.name for level in self.levels)]
        changing = [(level.ordered, level.confirmed + MAP_PERIOD_S)
                    for name, level in zip(before, self.levels)
                    if (name == "DEFAULT") != (level.name == "DEFAULT")]
        wrong = []
        for t, free, occupied in self.cells:
            person = any(begin <= t <= begin + PERSON_S + MAP_PERIOD_S for begin in self.person)
            keep_out = self.level_at(t, "confirmed") != "DEFAULT"
            allowed = floor.counts(keep_out, person)
            if any(begin <= t <= end for begin, end in changing):
                allowed = allowed | floor.counts(not keep_out, person)
            if free not in allowed or free + occupied != floor.cells:
                wrong.append(f"at {t:.1f} s the map had {free} free and {occupied} occupied cells, "
                             f"not {sorted(allowed)} free")
        return wrong[:3]

    # ----------------------------------------------------------------------------------- CSV

    def write_csv(self, path):
        offs = self.camera_offs()
        marks = list(self.events)
        for off, on in offs:
            before = [t for t in self.frames if t < on]
            after = [t for t in self.frames if t >= on]
            if before:
                marks.append((before[-1], "last_frame", ""))
            if after and on < self.seconds:
                marks.append((after[0], "first_frame", ""))
        rows = [(t, "", "") for t in steps(0, self.seconds)] + marks
        began = self.frames[0] if self.frames else self.seconds
        with open(path, "w", newline="", encoding="utf-8") as file:
            out = csv.writer(file, lineterminator="\n")
            out.writerow(CSV_COLUMNS)
            for t, event, detail in sorted(rows):
                _, free, occupied = last(self.cells, t, (0, "", ""))
                _, x, y, speed = last(self.poses, t, (0, "", "", ""))
                hz = f"{self.hz(t):.0f}" if t >= began + HZ_WINDOW_S else ""
                out.writerow([f"{t:.3f}", hz, free, occupied,
                              *(f"{value:.3f}" if value != "" else "" for value in (x, y, speed)),
                              f"{self.hz(t, self.twists):.0f}", self.level_at(t, "ordered"),
                              self.level_at(t, "confirmed"), event, detail])


def steps(begin, end):
    """Every STEP_S from one time to another."""
    return [begin + i * STEP_S for i in range(int((end - begin) / STEP_S + 1e-6) + 1)]


def last(series, t, none):
    at = bisect.bisect_right([entry[0] for entry in series], t)
    return series[at - 1] if at else none
