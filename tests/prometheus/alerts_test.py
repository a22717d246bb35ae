"""The alert rules under promtool: they are valid, and fire when they must and not else.

    alerts_test.py

Without promtool (the Debian package prometheus) the test is skipped, with code 77.
"""

import pathlib
import shutil
import subprocess
import sys
import tempfile

import yaml

HERE = pathlib.Path(__file__).resolve().parent
RULES = HERE.parents[1] / "deploy/prometheus/rips.rules.yml"
TESTS = HERE / "alerts_test.yml"


def untested(names, tests):
    """What is wrong with the list of tests: each alert fires in one, and does not in another."""
    cases = [case for test in tests for case in test["alert_rule_test"]]
    for name in names:
        results = {bool(case["exp_alerts"]) for case in cases if case["alertname"] == name}
        if results != {True, False}:
            yield f"{name}: needs a test in which it fires, and one in which it does not"
    for name in sorted({case["alertname"] for case in cases} - set(names)):
        yield f"{name}: no such alert"


def promtool(*args):
    done = subprocess.run(["promtool", *map(str, args)], capture_output=True, text=True,
                          timeout=120, check=False)
    return done.returncode, done.stdout + done.stderr


def main():
    rules, tests = (yaml.safe_load(path.read_text(encoding="utf-8")) for path in (RULES, TESTS))
    alerts = [rule for group in rules["groups"] for rule in group["rules"]]
    case = {"alertname": "A", "exp_alerts": []}
    assert len(list(untested(["A"], [{"alert_rule_test": [case]}]))) == 1
    assert len(list(untested([], [{"alert_rule_test": [case]}]))) == 1
    problems = list(untested([rule["alert"] for rule in alerts], tests["tests"]))
    if problems:
        sys.exit("\n".join(problems))
    if shutil.which("promtool") is None:
        print("skipped: promtool is not installed (the Debian package prometheus)")
        sys.exit(77)
    code, text = promtool("check", "rules", RULES)
    if code != 0:
        sys.exit(text)
    with tempfile.TemporaryDirectory() as directory:
        # Their texts are not compared: a better one is no other alert.
        for rule in alerts:
            del rule["annotations"]
        copy = pathlib.Path(directory, RULES.name)
        copy.write_text(yaml.safe_dump(rules), encoding="utf-8")
        shutil.copy(TESTS, directory)
        code, text = promtool("test", "rules", pathlib.Path(directory, TESTS.name))
        if code != 0:
            sys.exit(text)
        # promtool finds what it must.
        alerts[0]["expr"] += " and on() vector(0) > 1"
        copy.write_text(yaml.safe_dump(rules), encoding="utf-8")
        code, _ = promtool("test", "rules", pathlib.Path(directory, TESTS.name))
        if code == 0:
            sys.exit(f"promtool does not notice that {alerts[0]['alert']} never fires")
    print(f"{len(alerts)} alerts fire when they must")


if __name__ == "__main__":
    main()
