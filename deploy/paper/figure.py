"""Draw the timeline of one run of the paper's experiment: the camera's rate, the cells of the map
and the level of the robot over time, as SVG and PNG for light and dark pages."""

import argparse
import collections
import csv
import io
import itertools
import math
import pathlib
import re
import sys

try:
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path
    from matplotlib.ticker import MaxNLocator, MultipleLocator
except ImportError:
    sys.exit("figure.py: no matplotlib; install python3-matplotlib and use /usr/bin/python3")

COLUMNS = ("t", "hz", "free", "occupied", "confirmed", "event", "detail")
EVENTS = ("cause", "detected", "ordered", "confirmed", "last_frame", "first_frame")
LEVELS = ("DEFAULT", "ALERT", "COMPROMISED")

THEMES = {
    "light": {"page": "#ffffff", "ink": "#1f2328", "muted": "#59636e", "series": "#0060a8",
              "bars": ("#8c98a6", "#e69f00", "#aa3377", "#444a54"), "tint": (.10, .24, .24, .30)},
    "dark": {"page": "#0d1117", "ink": "#e6edf3", "muted": "#9aa4af", "series": "#63b3f5",
             "bars": ("#77828e", "#dd9c12", "#c9508f", "#c4ccd4"), "tint": (.10, .25, .34, .30)},
}

# All lengths are pixels of a picture 850 px wide, the width of a README.
WIDTH, LEFT, RIGHT = 850, 124, 54
PLOT = WIDTH - LEFT - RIGHT
ROW, BAR, GAP = 17, 14, 9
CAMERA, CELLS = 112, 84
TEXT, SMALL, TITLE = 12, 11, 15
PNG_WIDTH = 1600
MAX_DIRECT, MAX_LABEL_ROWS = 9, 6  # more causes, or more rows of labels, become numbers and a key

Event = collections.namedtuple("Event", "t detail")
Band = collections.namedtuple("Band", "start end level")
Label = collections.namedtuple("Label", "x left right row align")


class BadInput(Exception):
    pass


# ------------------------------------------------------------------------------------- the run


class Run:
    """The samples and the events of one CSV file."""

    def __init__(self, path):
        self.samples = []  # (t, hz, free, occupied, confirmed)
        self.events = {kind: [] for kind in EVENTS}
        try:
            with open(path, newline="", encoding="utf-8-sig") as file:
                self.read(csv.DictReader(file, restval=""), path)
        except OSError as error:
            raise BadInput(f"cannot read {path}: {error.strerror}") from None
        except (UnicodeDecodeError, csv.Error) as error:
            raise BadInput(f"{path} is not a CSV file: {error}") from None
        if len(self.samples) < 2 or self.samples[0][0] == self.samples[-1][0]:
            raise BadInput(f"{path} has no series of samples: the figure needs two or more rows "
                           "with an empty event")
        times = [sample[0] for sample in self.samples]
        times += [event.t for events in self.events.values() for event in events]
        self.start, self.end = min(times), max(times)
        self.bands = self.level_bands()

    def read(self, rows, path):
        if not rows.fieldnames:
            raise BadInput(f"{path} is empty")
        missing = [name for name in COLUMNS if name not in rows.fieldnames]
        if missing:
            raise BadInput(f"{path} lacks the column{'s' * (len(missing) > 1)} "
                           f"{', '.join(missing)}")
        before = -math.inf
        for row in rows:
            where = f"{path}, line {rows.line_num}"
            t = number(row["t"], where, "t")
            if not math.isfinite(t) or t < before:
                raise BadInput(f"{where}: t is {row['t'] or 'empty'}; the rows must be in the "
                               "order of time")
            before = t
            if not row["event"]:
                values = [number(row[name], where, name) for name in ("hz", "free", "occupied")]
                self.samples.append((t, *values, printable(row["confirmed"])))
            elif row["event"] in self.events:
                self.events[row["event"]].append(Event(t, printable(row["detail"])))
            else:
                raise BadInput(f"{where}: unknown event {row['event']!r}; use one of "
                               f"{', '.join(EVENTS)}")

    def level_bands(self):
        """Spans of one confirmed level; a change that was recorded as an event takes its time."""
        bands = []
        for level, samples in itertools.groupby(self.samples, key=lambda sample: sample[4]):
            at = next(samples)[0]
            near = [event.t for event in self.events["confirmed"]
                    if first_word(event.detail) == level and abs(event.t - at) < 0.5]
            if bands:
                at = min(near, key=lambda t: abs(t - at), default=at)
                bands[-1] = bands[-1]._replace(end=at)
            bands.append(Band(at, self.end, level))
        return [band for band in bands if band.level]

    def levels(self):
        return [*LEVELS, *sorted({band.level for band in self.bands} - set(LEVELS))]

    def plateaus(self, column):
        """The value seen most in DEFAULT, and the one seen most in the other levels."""
        groups = [[sample[column] for sample in self.samples
                   if (sample[4] == "DEFAULT") == default and math.isfinite(sample[column])]
                  for default in (True, False)]
        return [collections.Counter(group).most_common(1)[0][0] if group else None
                for group in groups]

    def confirm_delays(self):
        """(time, seconds since the order) of each confirmation that has an order of its own."""
        delays, orders = [], sorted(self.events["ordered"])
        for event in self.events["confirmed"]:
            asked = [order for order in orders if order.t <= event.t]
            if asked and first_word(asked[-1].detail) == first_word(event.detail):
                delays.append((event.t, event.t - asked[-1].t))
                orders = [order for order in orders if order.t > event.t]
        return delays

    def outages(self):
        """(last frame, first frame) of each time the camera was silent."""
        pairs = []
        for last in self.events["last_frame"]:
            first = [event.t for event in self.events["first_frame"] if event.t > last.t]
            if first and (not pairs or last.t >= pairs[-1][1]):
                pairs.append((last.t, first[0]))
        return pairs


def number(text, where, name):
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise BadInput(f"{where}: {name} is {text!r}, not a number") from None


def printable(text):
    return "".join(c if c.isprintable() else " " for c in text or "").strip()


def first_word(text):
    return text.split(" ", 1)[0]


def seconds(value):
    """Two significant digits, so that a delay of a few hundredths remains visible."""
    return f"{round(value, 1):g} s" if value >= 1 else f"{float(f'{round(value, 3):.2g}'):g} s"


def thin(points):
    """The points that the line needs: the inside of each straight level stretch goes."""
    kept = []
    for point in points:
        if len(kept) > 1 and kept[-1][1] == kept[-2][1] == point[1]:
            kept[-1] = point
        else:
            kept.append(point)
    return kept


# ------------------------------------------------------------------------------ places of labels


def text_width(text, size=SMALL):
    font = FontProperties(size=size)
    return text_to_path.get_text_width_height_descent(text, font, ismath=False)[0]


def shorten(text, room, size=SMALL):
    if text_width(text, size) <= room:
        return text
    while text and text_width(text + "…", size) > room:
        text = text[:-1]
    return text.rstrip() + "…"


def clash(one, two):
    """Whether two labels touch, or the stem of one passes through the other."""
    if one.row == two.row and one.left < two.right + 10 and two.left < one.right + 10:
        return True
    if abs(one.x - two.x) < 5 and one.align == two.align:  # their stems nearly coincide
        return True
    return any(label.left - 4 < stem.x < label.right + 4 and label.row <= stem.row
               for label, stem in ((one, two), (two, one)))


def stagger(marks, rows, placed=()):
    """Places for labels beside their marks [(x, width)], in `rows` rows; None if they do not fit.

    Row 0 holds the marks; the label of row n stands at the top of a stem n rows high."""
    if len(placed) == len(marks):
        return placed
    x, width = marks[len(placed)]
    for row in range(rows):
        for align, left in (("left", x + 7), ("right", x - 7 - width)):
            label = Label(x, left, left + width, row, align)
            if left < 4 or label.right > PLOT + RIGHT - 4:
                continue
            if any(clash(label, other) for other in placed):
                continue
            found = stagger(marks, rows, (*placed, label))
            if found is not None:
                return found
    return None


def beside(marks, blocked):
    """Places of texts [(x, text)] on the right or left of their marks, clear of `blocked`."""
    places, taken = [], []
    for x, text in marks:
        width = text_width(text)
        for align, left, near, far in (("left", x + 8, 4, 12), ("right", x - 8 - width, 12, 4)):
            right = left + width
            if left > 2 and right < PLOT + RIGHT and \
                    not any(left - near < line < right + far for line in blocked) and \
                    not any(left < end + 6 and start < right + 6 for start, end in taken):
                taken.append((left, right))
                places.append((x, text, align))
                break
    return places


# -------------------------------------------------------------------------------- the figure


class Timeline:
    """One figure in one theme. `back` spans the whole page and carries all but the curves."""

    def __init__(self, run, title, theme):
        self.run, self.theme = run, THEMES[theme]
        self.notes = []  # (draws the mark at (px, y), its width, text)
        self.plan_causes()
        self.plan_orders()
        self.plan_outages()
        self.note_rows = self.flow_notes()
        top = 36 if title else 8
        self.causes_y = top + ROW * self.cause_rows
        self.lanes = {name: self.causes_y + ROW * (n + .5)
                      for n, name in enumerate(("detected", "ordered", "confirmed"))}
        self.levels_y = self.causes_y + 3 * ROW + 3
        events_end = self.levels_y + BAR * len(run.levels()) + 3
        self.boxes = [(top - 2, events_end)]
        for height in (CAMERA, CELLS, CELLS):
            start = self.boxes[-1][1] + GAP
            self.boxes.append((start, start + height))
        self.bottom = self.boxes[-1][1]
        self.below = self.bottom + (46 if self.key or self.note_rows else 42)
        self.height = self.below + ROW * (len(self.key) + len(self.note_rows)) + 8

        self.figure = Figure(figsize=(WIDTH / 96, self.height / 96), dpi=96,
                             facecolor=self.theme["page"])
        self.back = self.axes(0, self.height)
        self.back.set_ylim(self.height, 0)
        self.back.axis("off")
        if title:
            self.margin_text(14, 16, shorten(title, WIDTH - 28, TITLE * 1.17), TITLE, "ink", True)
        self.draw_bands()
        self.draw_causes()
        self.draw_lanes()
        self.draw_levels()
        self.draw_camera()
        self.draw_cells()
        self.draw_key()
        self.draw_notes()

    # ------------------------------------------------------------------------------- helpers

    def px(self, t):
        return (t - self.run.start) / (self.run.end - self.run.start) * PLOT

    def at(self, px):
        return self.run.start + px / PLOT * (self.run.end - self.run.start)

    def axes(self, top, bottom):
        axes = self.figure.add_axes((LEFT / WIDTH, 1 - bottom / self.height, PLOT / WIDTH,
                                     (bottom - top) / self.height))
        axes.set_xlim(self.run.start, self.run.end)
        axes.patch.set_visible(False)
        return axes

    def text(self, px, y, text, align="left", size=SMALL, colour="ink", bold=False):
        """Text with its middle at height y, px pixels right of the start of the plot."""
        self.back.text(self.at(px), y + .36 * size, text, ha=align, va="baseline",
                       size=size * .75, color=self.theme[colour], parse_math=False,
                       weight="bold" if bold else "normal")

    def margin_text(self, px, y, text, size=SMALL, colour="ink", bold=False):
        self.text(px - LEFT, y, text, "left", size, colour, bold)

    def marker(self, t, y, shape, size=7.5, hollow=False):
        ink, page = self.theme["ink"], self.theme["page"]
        self.back.plot([t], [y], shape, ms=size * .75, mfc=page if hollow else ink, mec=ink,
                       mew=.75, clip_on=False, zorder=6)

    def line(self, xs, ys, colour="ink", width=1, style="-", zorder=4):
        self.back.plot(xs, ys, color=self.theme[colour], lw=width * .75, ls=style, zorder=zorder,
                       solid_capstyle="butt", dash_capstyle="butt", clip_on=False)

    def blend(self, colour, share):
        """An opaque colour between the page and `colour`."""
        pairs = zip(*(matplotlib.colors.to_rgb(each) for each in (self.theme["page"], colour)))
        return [page + (over - page) * share for page, over in pairs]

    def level_style(self, level):
        n = min(self.run.levels().index(level), 3)
        return self.theme["bars"][n], self.theme["tint"][n]

    def verticals(self):
        return sorted(self.px(event.t) for kind in ("ordered", "confirmed")
                      for event in self.run.events[kind])

    # ------------------------------------------------------------------------------- causes

    def plan_causes(self):
        """Labels beside the marks when they fit; otherwise numbers, and a key below."""
        causes = self.run.events["cause"]
        self.placed, self.numbers, self.key, self.cause_rows = None, [], [], 1
        if len(causes) <= MAX_DIRECT:
            marks = [(self.px(cause.t), text_width(cause.detail)) for cause in causes]
            for rows in range(1, MAX_LABEL_ROWS + 1):
                self.placed = stagger(marks, rows)
                if self.placed is not None:
                    self.cause_rows = rows
                    return
        names = list(dict.fromkeys(cause.detail for cause in causes))
        ends = []  # where the last number of each row ends
        for cause in causes:
            x = self.px(cause.t)
            row = next((n for n, end in enumerate(ends) if x - end > 17), len(ends))
            ends[row:row + 1] = [x]
            self.numbers.append((cause.t, row, str(names.index(cause.detail) + 1)))
        self.cause_rows = len(ends)
        self.key = self.plan_key([(str(n + 1), name) for n, name in enumerate(names)])

    def plan_key(self, entries):
        """Rows of key entries in as many columns as the longest text allows, down the columns."""
        room = PLOT + RIGHT - 14
        widest = max(text_width(name) for _, name in entries) + 40
        columns = max(1, min(3, int(room // widest)))
        rows = math.ceil(len(entries) / columns)
        pitch = room / columns
        return [[(pitch * (n // rows), mark, shorten(name, pitch - 22))
                 for n, (mark, name) in enumerate(entries) if n % rows == row]
                for row in range(rows)]

    def number_mark(self, px, y, mark):
        t = self.at(px)
        self.back.plot([t], [y], "o", ms=14 * .75, mfc=self.theme["page"], mec=self.theme["ink"],
                       mew=.75, clip_on=False, zorder=6)
        self.back.text(t, y + 3.5, mark, ha="center", va="baseline", size=9.5 * .75,
                       color=self.theme["ink"], zorder=7)

    def draw_causes(self):
        base = self.causes_y - ROW / 2
        self.margin_text(14, base, "Cause")
        for cause, label in zip(self.run.events["cause"], self.placed or ()):
            y = base - ROW * label.row
            if label.row:
                self.line([cause.t, cause.t], [base, y], "muted", .8)
                self.line([cause.t, self.at(label.x + (4 if label.align == "left" else -4))],
                          [y, y], "muted", .8)
            self.marker(cause.t, base, "o")
            self.text(label.left if label.align == "left" else label.right, y, cause.detail,
                      label.align)
        for t, row, mark in self.numbers:
            y = base - ROW * row
            self.line([t, t], [y, base + ROW / 2], "muted", .8)
            self.number_mark(self.px(t), y, mark)

    def draw_key(self):
        for n, row in enumerate(self.key):
            y = self.below + ROW * (n + .5)
            if n == 0:
                self.margin_text(14, y, "Causes")
            for px, mark, name in row:
                self.number_mark(px + 8, y, mark)
                self.text(px + 21, y, name)

    # -------------------------------------------------------------- orders, confirmations, levels

    def draw_bands(self):
        for band in self.run.bands:
            colour, share = self.level_style(band.level)
            for top, bottom in self.boxes:
                self.back.fill_between([band.start, band.end], top, bottom, lw=0, zorder=0,
                                       color=self.blend(colour, share))

    def plan_orders(self):
        """Who ordered, and the delay of each confirmation: beside all marks, or in a note."""
        orders = [(event.t, self.px(event.t), author(event.detail))
                  for event in self.run.events["ordered"]]
        for pick in (lambda text: text, first_word):
            self.authors = beside([(x, pick(name)) for _, x, name in orders],
                                  [x for _, x, _ in orders])
            if len(self.authors) == len(orders):
                break
        else:
            self.authors = []
            for hollow in (False, True):
                names = dict.fromkeys(name for *_, name in orders
                                      if name and by_operator(name) == hollow)
                if names:
                    self.notes.append((self.order_mark(hollow), 12,
                                       f"ordered: {', '.join(names)}"))
        delays = self.run.confirm_delays()
        self.delays = beside([(self.px(t), f"+{seconds(delay)}") for t, delay in delays],
                             self.verticals())
        if len(self.delays) < len(delays):
            self.delays = []
            low, high = (seconds(each(delay for _, delay in delays)) for each in (min, max))
            after = low if low == high else f"{low[:-2]} to {high}"
            self.notes.append((lambda px, y: self.marker(self.at(px + 4), y, "^", 8.5), 12,
                               f"confirmed {after} after the order"))

    def order_mark(self, hollow):
        return lambda px, y: self.marker(self.at(px + 4), y, "v", 8.5, hollow=hollow)

    def draw_lanes(self):
        lanes, events = self.lanes, self.run.events
        for name, y in lanes.items():
            self.margin_text(14, y, name.capitalize())
        for event in events["detected"]:
            self.marker(event.t, lanes["detected"], "D", 6)
        for event in events["ordered"]:
            self.order_mark(by_operator(author(event.detail)))(self.px(event.t) - 4,
                                                               lanes["ordered"])
            self.line([event.t] * 2, [lanes["ordered"], self.bottom], "ink", 1.1, (0, (4, 3)))
        for event in events["confirmed"]:
            self.marker(event.t, lanes["confirmed"], "^", 8.5)
            self.line([event.t] * 2, [lanes["confirmed"], self.bottom], "muted", 1.1, zorder=3)
        for name, places in (("ordered", self.authors), ("confirmed", self.delays)):
            for px, text, align in places:
                self.text(px + (8 if align == "left" else -8), lanes[name], text, align)

    # -------------------------------------------------------------------------------- the notes

    def flow_notes(self):
        """The notes in rows: [(px, draws the mark, width of the mark, text)]."""
        rows, px = [], PLOT
        for mark, room, text in self.notes:
            width = room + 4 + text_width(text)
            if px + width > PLOT + RIGHT - 8:
                rows.append([])
                px = 4
            rows[-1].append((px, mark, room, text))
            px += width + 26
        return rows

    def draw_notes(self):
        for n, row in enumerate(self.note_rows):
            y = self.below + ROW * (len(self.key) + n + .5) + 4
            if n == 0:
                self.margin_text(14, y, "Marks")
            for px, mark, room, text in row:
                mark(px, y)
                self.text(px + room + 5, y, text)

    def draw_levels(self):
        levels = self.run.levels()
        for n, level in enumerate(levels):
            y = self.levels_y + BAR * (n + .5)
            self.margin_text(22, y, level, size=10.5)
            colour, _ = self.level_style(level)
            self.back.hlines(y, self.run.start, self.run.end, color=self.theme["ink"], lw=.6,
                             alpha=.13, zorder=1)
            for band in self.run.bands:
                if band.level == level:
                    self.back.fill_between([band.start, band.end], y - BAR / 2 + 2,
                                           y + BAR / 2 - 2, color=colour, lw=0, zorder=2)

    # ------------------------------------------------------------------------------ the curves

    def panel(self, n, name, unit):
        top, bottom = self.boxes[n]
        axes = self.axes(top, bottom)
        for side, spine in axes.spines.items():
            spine.set_visible(side in ("left", "bottom"))
            spine.set(color=self.theme["muted"], linewidth=.75)
        axes.xaxis.set_major_locator(MultipleLocator(tick_step(self.run.end - self.run.start)))
        axes.tick_params(color=self.theme["muted"], labelcolor=self.theme["ink"], length=3,
                         width=.75, labelsize=SMALL * .75, pad=3, labelbottom=n == 3)
        axes.grid(color=self.theme["ink"], alpha=.13, lw=.6)
        axes.set_axisbelow(True)
        middle = (top + bottom) / 2
        self.margin_text(14, middle - 8, name, TEXT, bold=True)
        self.margin_text(14, middle + 8, unit, SMALL, "muted")
        if n == 3:
            axes.set_xlabel("Simulated time in seconds", size=TEXT * .75, labelpad=3,
                            color=self.theme["ink"])
        return axes

    def curve(self, axes, column, style):
        points = thin([(sample[0], round(sample[column], 2)) for sample in self.run.samples])
        axes.plot(*zip(*points), color=self.theme["series"], lw=1.7 * .75, drawstyle=style,
                  solid_joinstyle="round", zorder=5)

    def finite(self, column):
        return [sample[column] for sample in self.run.samples if math.isfinite(sample[column])]

    def plan_outages(self):
        """The length of each silence of the camera, between two vertical lines if it fits."""
        self.outages = []  # (last, first, px of the middle of the text, text)
        for last, first in self.run.outages():
            cuts = [self.px(last), *(x for x in self.verticals()
                                     if self.px(last) < x < self.px(first)), self.px(first)]
            left, right = max(zip(cuts, cuts[1:]), key=lambda cut: cut[1] - cut[0])
            length = f"{first - last:.1f} s"
            fits = [text for text in (f"no pictures for {length}", length, "")
                    if text_width(text) < right - left - 8]
            self.outages.append((last, first, (left + right) / 2, fits[0] if fits else ""))
        if any(not text.startswith("no") for *_, text in self.outages):
            self.notes.append((lambda px, y: self.span(self.at(px), self.at(px + 18), y), 18,
                               "no pictures"))

    def span(self, start, end, y):
        self.line([start, end], [y, y])
        for t in (start, end):
            self.line([t, t], [y - 4, y + 4])

    def draw_camera(self):
        axes = self.panel(1, "Camera", "pictures, Hz")
        top = max([*self.finite(1), 10]) * 1.2
        axes.set_ylim(-.05 * top, top)
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10], integer=True))
        self.curve(axes, 1, "default")
        y = self.boxes[1][0] + .42 * CAMERA
        for last, first, px, text in self.outages:
            self.span(last, first, y)
            self.text(px, y - 10, text, "center")

    def draw_cells(self):
        ranges = [(min(values), max(values)) if values else (0, 1)
                  for values in (self.finite(2), self.finite(3))]
        span = max(20, *(high - low for low, high in ranges)) * 1.3  # one scale for both panels
        for n, (name, (low, high)) in enumerate(zip(("Free", "Occupied"), ranges)):
            axes = self.panel(n + 2, name, "map cells")
            middle = (low + high) / 2
            axes.set_ylim(middle - span / 2, middle + span / 2)
            self.curve(axes, n + 2, "steps-post")
            base, changed = self.run.plateaus(n + 2)
            ticks = [value for value in (base, changed) if value is not None]
            if len(ticks) == 2 and abs(base - changed) < .18 * span:
                ticks = ticks[:1]
            axes.set_yticks(ticks)
            axes.set_yticklabels([f"{value:.0f}" for value in ticks])
            if len(ticks) == 2:
                self.bracket(n + 2, axes, base, changed)

    def bracket(self, n, axes, base, changed):
        """The change of the cells, beside the panel."""
        top, bottom = self.boxes[n]
        low, high = axes.get_ylim()
        ys = [bottom - (value - low) / (high - low) * (bottom - top) for value in (base, changed)]
        xs = [self.at(PLOT + px) for px in (4, 8, 8, 4)]
        self.line(xs, [ys[0], ys[0], ys[1], ys[1]], "muted", .9)
        sign = "−" if changed < base else "+"
        self.text(PLOT + 13, sum(ys) / 2, f"{sign}{abs(changed - base):.0f}")


def author(detail):
    """The part of "ALERT (rule alone)" in brackets."""
    found = re.search(r"\(([^)]*)\)", detail)
    return found.group(1) if found else ""


def by_operator(name):
    return name.startswith("operator")


def tick_step(span):
    return next((step for step in (1, 2, 5, 10, 20, 50, 100, 200, 500) if span / step <= 12), 1000)


def compact(svg):
    """Coordinates of paths with two decimals; matplotlib writes six."""
    def shorter(line):
        return re.sub(r"\d+\.\d{3,}", lambda found: f"{float(found.group()):.2f}", line.group())
    return re.sub(r'(?m)^(?:[LM] | *<path d="M ).*$', shorter, svg)


def draw(run, title, out):
    matplotlib.rcdefaults()
    matplotlib.rcParams.update({
        "font.family": ["sans-serif"],
        "font.sans-serif": ["DejaVu Sans", "Verdana", "Helvetica", "Arial"],  # alike in width first
        "svg.fonttype": "none", "svg.hashsalt": "rips", "path.simplify": True,
        "axes.unicode_minus": True})
    for theme in THEMES:
        figure = Timeline(run, title, theme).figure
        svg = io.StringIO()
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None,
                                                    **({"Title": title} if title else {})})
        pathlib.Path(f"{out}-{theme}.svg").write_text(compact(svg.getvalue()), encoding="utf-8")
        figure.savefig(f"{out}-{theme}.png", dpi=96 * PNG_WIDTH / WIDTH,
                       metadata={"Software": None})


def main():
    parser = argparse.ArgumentParser(description="Draw the timeline of one run of the paper's "
                                                 "experiment.")
    parser.add_argument("csv", metavar="RUN.csv", help="samples and events of the run")
    parser.add_argument("--title", default="", help="heading of the figure")
    parser.add_argument("--out", required=True, metavar="DIR/NAME",
                        help="write DIR/NAME-light.svg, -dark.svg, -light.png and -dark.png")
    options = parser.parse_args()
    try:
        run = Run(options.csv)
        pathlib.Path(options.out).parent.mkdir(parents=True, exist_ok=True)
        draw(run, printable(options.title), options.out)
    except BadInput as error:
        print(f"figure.py: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"figure.py: cannot write {options.out}: {error.strerror}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
