"""Every test that statements.txt names exists."""

import pathlib
import re
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
FOLDERS = ["policy_server", "services", "mode_actuator", "tests"]
YAML = [HERE / "statements_test.yaml", ROOT / "rules/LANGUAGE.md", ROOT / "rules/PROTOTYPE.md"]


def known():
    tests = set()
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*_test.cc"):
            found = re.findall(r"\bTEST(?:_F|_P)?\(\s*(\w+)\s*,\s*(\w+)\s*\)",
                               path.read_text(encoding="utf-8"))
            tests |= {".".join(one) for one in found}
    tests |= {path.name for path in HERE.glob("*.rul")}
    for path in YAML:
        tests |= set(re.findall(r'^ +- name: "?(.*?)"?$', path.read_text(encoding="utf-8"), re.M))
    return tests


def main():
    tests, problems, seen = known(), [], set()
    for number, line in enumerate((HERE / "statements.txt").read_text(encoding="utf-8").splitlines(),
                                  1):
        if not line or line.startswith(("#", "[")):
            continue
        statement, bar, names = line.rpartition(" | ")
        if not bar or not statement.strip():
            problems.append(f"statements.txt:{number}: a line is `statement | test, test`")
            continue
        if statement in seen:
            problems.append(f"statements.txt:{number}: said already: {statement}")
        seen.add(statement)
        for quoted, plain in re.findall(r'"([^"]+)"|([^,"\s]+)', names):
            if (quoted or plain) not in tests:
                problems.append(f"statements.txt:{number}: there is no test {quoted or plain}")
    print("\n".join(problems))
    print(f"{len(seen)} statements, {len(problems)} problems")
    return 1 if problems or not seen else 0


if __name__ == "__main__":
    sys.exit(main())
