"""The tables of policy_server/FAULTS.md and server/FAULTS.md name tests and counters that exist.

    fault_table_test.py BUILD BINARIES      BUILD: where ctest runs; BINARIES: the daemons

A row is `| what fails | effect on the level | alert or record | counter | test |`. A test is a ctest
name, or a gtest name of a test binary of BUILD. A counter is on /metrics of the daemon from its
start; `sensor:` or `actuator:` in front of it names another daemon than the policy server.
"""

import json
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import Failed, Fleet, metrics  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
PAGES = ["policy_server/FAULTS.md", "policy_server/server/FAULTS.md"]
COLUMNS = ["what fails", "effect on the level", "alert or record", "counter", "test"]
SERVER = "policy-server"
DAEMONS = [SERVER, "sensor", "actuator"]
# A page with fewer rows was read wrongly.
ROWS_MIN = 25


def cells(line):
    """The cells of a table row; `\\|` and a bar inside a code span are text."""
    text = line.strip()[1:-1]
    return [part.strip() for part in re.findall(r"((?:`[^`]*`|\\.|[^|`])*)(?:\||$)", text)][:-1]


def read_rows(page):
    """(line number, cells) of each row of all tables, and what is wrong with the tables' form."""
    rows, problems = [], []
    before = ""
    for number, line in enumerate(page.splitlines(), 1):
        if not line.startswith("|"):
            before = line
            continue
        row = cells(line)
        if not before.startswith("|"):
            if row != COLUMNS:
                problems.append(f"line {number}: the columns are not {' | '.join(COLUMNS)}")
        elif set(line) <= set("|-"):
            pass
        elif len(row) != len(COLUMNS):
            problems.append(f"line {number}: {len(row)} cells, not {len(COLUMNS)}")
        else:
            rows.append((number, row))
            if "" in row:
                problems.append(f"line {number}: an empty cell; write - for none")
        before = line
    return rows, problems or ([] if rows else ["there is no table"])


def read_tests(cell):
    """The test names of a cell; None if there are none or the cell says something else."""
    names = [part.strip() for part in cell.split(",")]
    if not all(re.fullmatch(r"`[\w./-]+`", name) for name in names):
        return None
    return [name.strip("`") for name in names]


def read_counters(cell):
    """(daemon, metric) pairs of a cell, [] for `-`; None if it says something else."""
    if cell == "-":
        return []
    found = [re.fullmatch(r"(?:([\w-]+): )?`(rips_\w+)`", part.strip()) for part in cell.split(",")]
    if not all(found) or any(each[1] not in [None, *DAEMONS] for each in found):
        return None
    return [(each[1] or SERVER, each[2]) for each in found]


def read_table(page):
    """(rows, problems); a row is (line number, test names, (daemon, metric) pairs)."""
    table, problems = read_rows(page)
    rows = []
    for number, row in table:
        tests, counters = read_tests(row[4]), read_counters(row[3])
        if tests is None:
            problems.append(f"line {number}: no list of tests such as `Suite.Name`, `fleet.drill`: "
                            f"{row[4]}")
        if counters is None:
            problems.append(f"line {number}: no list of counters such as `rips_alerts_total`, "
                            f"sensor: `rips_sensor_lost_total`: {row[3]}")
        rows.append((number, tests or [], counters or []))
    return rows, problems


def missing(rows, tests, pages):
    """What the rows name and is neither in `tests` nor on `pages` (daemon to metric names)."""
    problems = [f"line {number}: there is no test {name}"
                for number, names, _ in rows for name in names if name not in tests]
    return problems + [f"line {number}: {metric} is not on /metrics of the {daemon}"
                       for number, _, counters in rows for daemon, metric in counters
                       if metric not in pages[daemon]]


def known_tests(build):
    """Names of ctest and of every test binary that is built; a suite of parameters without them."""
    listed = subprocess.run(["ctest", "--test-dir", build, "--show-only=json-v1"], check=True,
                            capture_output=True, text=True, timeout=60).stdout
    names = {test["name"] for test in json.loads(listed)["tests"]}
    for binary in sorted(pathlib.Path(build, "tests").glob("*_test")):
        suite = ""
        for line in subprocess.run([binary, "--gtest_list_tests"], check=True, capture_output=True,
                                   text=True, timeout=60).stdout.splitlines():
            text = line.partition("#")[0].rstrip()
            if not text.startswith(" "):
                suite = text.rpartition("/")[2].strip(".") if text.endswith(".") else ""
                suite = suite if not suite.isdigit() else text.split("/")[-2]
            elif suite:
                names.add(f"{suite}.{text.strip().partition('/')[0]}")
    return names


def metric_pages(binaries, daemons):
    """The names of metrics on the page of each daemon that has just been started."""
    parent = pathlib.Path(binaries).resolve().parent / "scenarios"
    parent.mkdir(exist_ok=True)
    directory = pathlib.Path(tempfile.mkdtemp(prefix="fault_table.", dir=parent))
    fleet = Fleet(binaries, directory)
    fleet.sensor_options = f"""ids: [{{format: eve, path: {directory}/eve.json}}]
outbox: {{memory: 64MiB, disk: 64MiB, dir: {directory}/sensor/spool}}
wire: {{enabled: true, socket: {directory}/wire.sock}}
"""
    try:
        fleet.prepare()
        started = {SERVER: fleet.start_server()}
        pages = {SERVER: metrics(started[SERVER])}
        for role in sorted(daemons - {SERVER}):
            pages[role] = metrics(fleet.start_agent(role))
    finally:
        fleet.stop()
    shutil.rmtree(directory)
    return pages


def check_the_check():
    """What this test is for is found."""
    head = ["| " + " | ".join(COLUMNS) + " |", "|---|---|---|---|---|"]
    page = "\n".join([
        "## One", "", *head,
        "| a | b | `a|b` | `rips_a_total`, sensor: `rips_b_total` | `A.B`, `fleet.drill` |",
        "| a | b | c | `rips_a_total` | `A.C` |",
        "| a | b | c | - | `A.B…` |",
        "| a | b | c | `a_total` | `A.B` |",
        "## Two", "", *head,
        "| a | b | c | robot: `rips_a_total` | `A.B` |",
        "| a | b |  | - | `A.B` |",
        "| a | b | - | `A.B` |",
        "", "| a | b |"])
    rows, problems = read_table(page)
    problems += missing(rows, {"A.B", "fleet.drill"}, {SERVER: {"rips_b_total"}, "sensor": set()})
    expected = ["line 14: an empty", "line 15: 4 cells", "line 17: the columns are not",
                "line 7: no list of tests", "line 8: no list of counters",
                "line 13: no list of counters",
                "line 6: there is no test A.C",
                "line 5: rips_a_total is not on /metrics of the policy-server",
                "line 5: rips_b_total is not on /metrics of the sensor",
                "line 6: rips_a_total is not on /metrics of the policy-server"]
    assert len(problems) == len(expected), problems
    for problem, beginning in zip(problems, expected):
        assert problem.startswith(beginning), (problem, beginning)
    assert read_table("| a |")[1]


def main():
    check_the_check()
    build, binaries = sys.argv[1:3]
    read = {page: read_table((ROOT / page).read_text(encoding="utf-8")) for page in PAGES}
    named = {daemon for rows, _ in read.values() for _, _, counters in rows
             for daemon, _ in counters}
    problems = []
    try:
        tests, metrics_of = known_tests(build), metric_pages(binaries, named)
    except Failed as failed:
        problems.append(str(failed))
        tests, metrics_of = None, None
    for page, (rows, wrong) in read.items():
        if len(rows) < ROWS_MIN:
            wrong.append(f"{len(rows)} rows, fewer than {ROWS_MIN}")
        if tests is not None:
            wrong += missing(rows, tests, metrics_of)
        problems += [f"{page}: {each}" for each in wrong]
    print("\n".join([*problems, f"{sum(len(rows) for rows, _ in read.values())} rows, "
                                f"{len(problems)} problems"]))
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
