"""Every test that statements.txt names exists, and every builtin and kind of finding is described.

A builtin has a statement in statements.txt, and prose in rules/LANGUAGE.md; a kind of finding has
prose in the section of external events.
"""

import pathlib
import re
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
FOLDERS = ["policy_server", "services", "mode_actuator", "tests"]
LANG = ROOT / "policy_server/policy/lang"
MANUAL = ROOT / "rules/LANGUAGE.md"
GENERATED = re.compile(r"<!-- generated: .*?<!-- end of generated -->", re.S)
FINDINGS = "External events and the tick"
YAML = [HERE / "statements_test.yaml", MANUAL, ROOT / "rules/PROTOTYPE.md"]


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


def undescribed(statements):
    """Of the words that a rule may use, those that no page describes."""
    signatures = (LANG / "check/signature.cc").read_text(encoding="utf-8")
    builtins = re.findall(r'^RIPS_\w+\(\w+, "(\w+)"',
                          (LANG / "builtin.def").read_text(encoding="utf-8"), re.M)
    findings = re.findall(r'"(\w+)"', signatures.split("kFindings[] = {")[1].split("};")[0])
    assert len(builtins) > 50 and findings, "cannot read builtin.def and signature.cc"
    manual = GENERATED.sub("", MANUAL.read_text(encoding="utf-8"))
    section = manual.split(f"\n## {FINDINGS}\n")[1].split("\n## ")[0]
    told = "\n".join(statements)
    for words, text, where in ((builtins, told, "statements.txt: no statement about"),
                               (builtins, manual, "LANGUAGE.md: no prose, outside of the generated "
                                                  "reference, about"),
                               (findings, section, f"LANGUAGE.md: `{FINDINGS}` says nothing of")):
        for word in words:
            # Some are English words, too: a page sets them as code.
            code = word if text is told else rf"`\"?{word}\b[^`]*`"
            if not re.search(rf"(?<!\w){code}(?!\w)", text):
                yield f"{where} {word}"


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
    problems += undescribed(seen)
    print("\n".join(problems))
    print(f"{len(seen)} statements, {len(problems)} problems")
    return 1 if problems or not seen else 0


if __name__ == "__main__":
    sys.exit(main())
