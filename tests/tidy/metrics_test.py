"""The metrics of the policy server: METRICS.md, the code and the alert rules agree, as a test.

Every name in the code stands in the list once, with its type, and every name of the list in the
code. Alert rules name only metrics that the list has, and have the form that Prometheus reads.
"""

import pathlib
import re
import sys

import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
PAGE = "policy_server/METRICS.md"
RULES = "deploy/prometheus/rips.rules.yml"
ITEM = re.compile(r"- `(?P<name>rips_\w+)` \((?P<type>\w+)(?:; `\w+`(?:, `\w+`)*)?\): "
                  r"\S.*\. \*Do:\* \S.*\.")
# What only other daemons have; the rest of services/ the server has, too.
FOLDERS = ["policy_server", "services/rpc", "services/runtime", "services/wire_limits"]
TYPE_OF_CALL = {"AddCounter": "counter", "counter": "counter", "AddGauge": "gauge",
                "AddTable": "gauge", "table": "gauge", "AddHistogram": "histogram"}
SUFFIXES = ("_bucket", "_sum", "_count")
RULE_KEYS = {"alert", "expr", "for", "labels", "annotations"}


def in_code(text):
    """{name: type} of what a source file makes; a type of None: the call is not known."""
    return {name: TYPE_OF_CALL.get(call)
            for call, name in re.findall(r'(\w*)\(\s*"(rips_\w+)"', text)}


def in_page(text):
    """({name: type}, problems) of the list: an item is ITEM, on one line or more."""
    found, problems = {}, []
    for item in re.split(r"\n(?=- |\n|#)", text):
        item = " ".join(item.split())
        if not item.startswith("- `rips_") or item.startswith("- `rips_robot_*`"):
            continue
        match = ITEM.fullmatch(item)
        if match is None:
            problems.append(f"not `NAME` (TYPE; LABELS): MEANING. *Do:* ACTION.: {item}")
        elif match["name"] in found:
            problems.append(f"{match['name']} stands there twice")
        else:
            found[match["name"]] = match["type"]
    return found, problems


def differences(code, page):
    for name in sorted(code.keys() | page.keys()):
        if name not in page:
            yield f"{name}: missing from {PAGE}"
        elif name not in code:
            yield f"{name}: no code makes it"
        elif code[name] is None:
            yield f"{name}: the call that makes it is none of {', '.join(TYPE_OF_CALL)}"
        elif code[name] != page[name]:
            yield f"{name}: a {code[name]}, not a {page[name]} as {PAGE} says"


def rule_problems(rule, metrics):
    """What is wrong with one alert rule."""
    if not isinstance(rule, dict) or not isinstance(rule.get("alert"), str):
        yield f"not an alert: {rule}"
        return
    unknown = set(rule) - RULE_KEYS
    if unknown:
        yield f"unknown keys {sorted(unknown)}"
    expr = rule.get("expr")
    if not isinstance(expr, str) or any(expr.count(a) != expr.count(b) for a, b in ("()", "{}", "[]")):
        yield f"no expression: {expr}"
        return
    names = set(re.findall(r"\brips_\w+", expr))
    if not names:
        yield "names no metric"
    for name in sorted(names):
        whole = next((name.removesuffix(end) for end in SUFFIXES
                      if metrics.get(name.removesuffix(end)) == "histogram"), name)
        if whole not in metrics or (whole == name and metrics[name] == "histogram"):
            yield f"no metric {name}"
    if not re.fullmatch(r"\d+[smhd]", str(rule.get("for", "0s"))):
        yield f"for: {rule['for']} is no duration"
    if rule.get("labels", {}).get("severity") not in ("page", "ticket"):
        yield "severity is neither page nor ticket"
    if not {"summary", "action"} <= set(rule.get("annotations", {})):
        yield "no summary or no action"


def rules_problems(text, metrics):
    try:
        groups = yaml.safe_load(text)["groups"]
        rules = [(group["name"], rule) for group in groups for rule in group["rules"]]
    except (yaml.YAMLError, KeyError, TypeError) as error:
        yield f"not a file of rules: {error!r}"
        return
    seen = set()
    for group, rule in rules:
        name = rule.get("alert") if isinstance(rule, dict) else None
        if name in seen:
            yield f"{group}: {name} stands there twice"
        seen.add(name)
        yield from (f"{group}: {name}: {problem}" for problem in rule_problems(rule, metrics))


def check_self():
    """This test finds what it must."""
    code = in_code('m.AddCounter(\n    "rips_a_total", counter("rips_b_total" odd("rips_c" "rips_d"')
    assert code == {"rips_a_total": "counter", "rips_b_total": "counter", "rips_c": None}, code
    item = "- `rips_a_total` (gauge; `robot`, `host`): so\n  many. *Do:* this.\n"
    for bad in (item, "- `rips_a`: no type. *Do:* this.\n", "- `rips_a` (gauge): no action.\n",
                "- `rips_a` (gauge; robot): x. *Do:* y.\n", "- `rips_a` (gauge): *Do:* y.\n"):
        page, problems = in_page(f"# Page\n\n{item}{bad}\n## Next\n- other\n")
        assert page == {"rips_a_total": "gauge"} and len(problems) == 1, (bad, problems)
    assert list(differences(code, page | {"rips_z": "gauge"})) == [
        f"rips_a_total: a counter, not a gauge as {PAGE} says", f"rips_b_total: missing from {PAGE}",
        f"rips_c: missing from {PAGE}", "rips_z: no code makes it"]
    good = {"alert": "A", "expr": "rate(rips_h_bucket[1m]) > rips_a", "for": "5m",
            "labels": {"severity": "page"}, "annotations": {"summary": "s", "action": "a"}}
    metrics = {"rips_a": "gauge", "rips_h": "histogram"}
    assert not list(rule_problems(good, metrics))
    for bad in ({"expr": "rips_b > 0"}, {"expr": "rips_h > 0"}, {"expr": "rips_a_bucket > 0"},
                {"expr": "(rips_a > 0"}, {"expr": "up"}, {"for": "long"}, {"labels": {}},
                {"annotations": {}}, {"alert": None}, {"fro": "5m"}):
        assert len(list(rule_problems(good | bad, metrics))) == 1, bad
    for bad in ("groups: [", "groups: 1", "[]", "groups: [{name: g}]"):
        assert len(list(rules_problems(bad, metrics))) == 1, bad


def main():
    check_self()
    code = {}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.cc")) + sorted((ROOT / folder).rglob("*.h")):
            if not path.name.endswith("_test.cc"):
                code |= in_code(path.read_text(encoding="utf-8"))
    assert code, "no code makes a metric: its calls have other names"
    page, problems = in_page((ROOT / PAGE).read_text(encoding="utf-8"))
    problems += differences(code, page)
    problems = [f"{PAGE}: {problem}" for problem in problems]
    problems += (f"{RULES}: {problem}"
                 for problem in rules_problems((ROOT / RULES).read_text(encoding="utf-8"), page))
    print("\n".join(problems) or f"{len(page)} metrics agree")
    sys.exit(1 if problems else 0)


if __name__ == "__main__":
    main()
