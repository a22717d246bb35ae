"""The Grafana dashboard deploy/grafana/rips.json: its shape, its metrics and its expressions.

Whether expressions parse needs promtool; without it the rest is tested, and the test says so.
"""

import json
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/tidy"))
from metrics_test import PAGE, SUFFIXES, in_page  # noqa: E402

BOARD = ROOT / "deploy/grafana/rips.json"
COLUMNS = 24
OWN_VARIABLES = {"__rate_interval"}  # Grafana's


def overlaps(a, b):
    return (a["x"] < b["x"] + b["w"] and b["x"] < a["x"] + a["w"] and
            a["y"] < b["y"] + b["h"] and b["y"] < a["y"] + a["h"])


def metric_problems(text, metrics):
    for name in sorted(set(re.findall(r"\brips_\w+", text))):
        whole = next((name.removesuffix(end) for end in SUFFIXES
                      if metrics.get(name.removesuffix(end)) == "histogram"), name)
        if whole not in metrics or (whole == name and metrics[name] == "histogram"):
            yield f"no metric {name}"


def panel_problems(panel, metrics, variables):
    """What is wrong with one panel."""
    grid = panel.get("gridPos")
    if not isinstance(grid, dict) or any(type(grid.get(key)) is not int for key in "xywh"):
        yield "no gridPos"
    elif not (0 <= grid["x"] < grid["x"] + grid["w"] <= COLUMNS and grid["y"] >= 0 < grid["h"]):
        yield f"gridPos {grid} is not within {COLUMNS} columns"
    if not panel.get("title") or panel.get("type") not in ("row", "stat", "timeseries"):
        yield "no title, or a type that is none of row, stat, timeseries"
    if panel.get("type") == "row":
        return
    if not panel.get("targets"):
        yield "no targets"
    for target in panel.get("targets", []):
        expr = target.get("expr", "")
        if "rips_" not in expr:
            yield f"names no metric: {expr!r}"
        yield from metric_problems(expr, metrics)
        for uid in (panel, target):
            if uid.get("datasource", {}).get("uid") != "${datasource}":
                yield "its data source is not the variable"
        for name in re.findall(r"\$\{?(\w+)", expr):
            if name not in variables | OWN_VARIABLES:
                yield f"no variable {name}"


def problems_of(board, metrics):
    if type(board.get("schemaVersion")) is not int or not (board.get("title") and board.get("uid")):
        yield "no schemaVersion, title or uid"
    variables = {each.get("name") for each in board.get("templating", {}).get("list", [])}
    for name in sorted({"datasource", "robot"} - variables):
        yield f"no variable {name}"
    for each in board.get("templating", {}).get("list", []):
        yield from metric_problems(str(each.get("definition", "")), metrics)
    panels = board.get("panels") or []
    if not panels:
        yield "no panels"
    ids = [panel.get("id") for panel in panels]
    if len(set(ids)) != len(ids) or not all(type(each) is int for each in ids):
        yield "ids of panels are not whole numbers, each once"
    bad = False
    for panel in panels:
        for problem in panel_problems(panel, metrics, variables):
            bad = True
            yield f"panel {panel.get('id')} ({panel.get('title')}): {problem}"
    if not bad:
        yield from (f"panels {a['id']} and {b['id']} overlap" for i, a in enumerate(panels)
                    for b in panels[:i] if overlaps(a["gridPos"], b["gridPos"]))


def parse_problem(exprs):
    """What promtool says of the expressions, with Grafana's variables replaced."""
    rules = [{"record": f"a{i}", "expr": expr.replace("$__rate_interval", "5m")}
             for i, expr in enumerate(exprs)]
    with tempfile.TemporaryDirectory() as directory:
        path = pathlib.Path(directory, "rules.yml")
        path.write_text(yaml.safe_dump({"groups": [{"name": "g", "rules": rules}]}), "utf-8")
        done = subprocess.run(["promtool", "check", "rules", path], capture_output=True, text=True,
                              timeout=60, check=False)
    return "" if done.returncode == 0 else done.stdout + done.stderr


def check_self():
    """This test finds what it must."""
    metrics = {"rips_a": "gauge", "rips_h": "histogram"}
    source = {"uid": "${datasource}"}
    def board(panel=None, second=None, **other):
        good = {"id": 1, "title": "t", "type": "stat", "datasource": source,
                "gridPos": {"x": 0, "y": 0, "w": 12, "h": 8},
                "targets": [{"expr": "rips_a", "datasource": source}]}
        panels = [good | (panel or {})] + ([good | second] if second else [])
        return {"schemaVersion": 1, "title": "t", "uid": "u", "panels": panels, "templating": {
            "list": [{"name": "datasource"}, {"name": "robot"}]}} | other
    right = {"id": 2, "gridPos": {"x": 12, "y": 0, "w": 12, "h": 8}}
    assert not list(problems_of(board(second=right), metrics))
    def expr(text):
        return {"targets": [{"expr": text, "datasource": source}]}
    for bad in (board({"id": "1"}), board(second={"id": 2}), board(second=right | {"id": 1}),
                board({"gridPos": {}}), board({"gridPos": {"x": 13, "y": 0, "w": 12, "h": 8}}),
                board({"title": ""}), board({"type": "graph"}), board({"targets": []}),
                board({"datasource": {"uid": "x"}}), board(expr("up")), board(expr("rips_b")),
                board(expr("rips_h")), board(expr("rips_a{r='$r'}")), board(panels=[]),
                board(schemaVersion="1"), board(templating={"list": [{"name": "robot"}]})):
        assert len(list(problems_of(bad, metrics))) == 1, (bad, list(problems_of(bad, metrics)))


def main():
    check_self()
    metrics, _ = in_page((ROOT / PAGE).read_text(encoding="utf-8"))
    try:
        board = json.loads(BOARD.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        sys.exit(f"{BOARD}: not JSON: {error}")
    problems = list(problems_of(board, metrics))
    if problems:
        sys.exit("\n".join(problems))
    exprs = [target["expr"] for panel in board["panels"] for target in panel.get("targets", [])]
    if shutil.which("promtool") is None:
        print("promtool is not installed: expressions are not parsed")
    else:
        if not parse_problem(["rate(rips_alerts_total"]):
            sys.exit("promtool does not notice an expression that does not parse")
        if problem := parse_problem(exprs):
            sys.exit(problem)
    print(f"{len(board['panels'])} panels, {len(exprs)} expressions")


if __name__ == "__main__":
    main()
