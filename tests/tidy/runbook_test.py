"""The runbook: deploy/RUNBOOK.md, the alert rules, the findings and the server's alerts agree.

Each alert rule, each kind of finding and each alert of severity high or critical that the server
raises has a section, and no section is about anything else. A command of ripsctl in it names a verb
and flags that `ripsctl --help` has, as pinned in testdata/help.txt.
"""

import pathlib
import re
import shlex
import sys

import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
PAGE = "deploy/RUNBOOK.md"
RULES = "deploy/prometheus/rips.rules.yml"
INSTALLED = "/usr/share/doc/rips-tools/RUNBOOK.md"
SERVER = ["policy_server/server", "policy_server/policy/engine/chains"]
# Where the texts of alerts are made.
TEXTS = SERVER + ["policy_server/audit", "services/rpc"]
LITERAL = r'"((?:[^"\\\n]|\\.)*)"'
# {file: number of alerts whose text is not in the statement that raises them}. Their texts are made
# elsewhere, have a section, and are looked for in the code like the others.
ELSEWHERE = {
    "policy_server/server/attack_alerts.cc": 1,
    "policy_server/server/fleet.cc": 2,
    "policy_server/server/operator_api/operator_service.cc": 1,
    "policy_server/server/robot/actuators/actuator_side.cc": 2,
    "policy_server/server/robot/context/alerts.cc": 1,
    "policy_server/server/robot/decide/admission.cc": 2,
    "policy_server/server/robot/sensors/sensor_side.cc": 1,
    "policy_server/server/rollout/bundle_control.cc": 1,
    "policy_server/server/robot/sight/findings.cc": 1,
    "policy_server/server/server.cc": 2,
    "policy_server/server/server_certificates.cc": 1,
    "policy_server/server/shard/agent_alerts.h": 1,
    "policy_server/server/shard/store_watch.cc": 1,
}
NOT_RAISED = re.compile(r"severity = |>= |kHigh, engine::Severity::kCritical\}|"
                        r"engine::Severity::kCritical\};|for \(const Severity|"
                        r"Severity::kMedium, engine")


def sections(text):
    """{chapter: {heading: body}}."""
    found = {}
    for chapter in re.split(r"^## ", text, flags=re.M)[1:]:
        name, _, rest = chapter.partition("\n")
        parts = re.split(r"^### ", rest, flags=re.M)
        found[name] = dict(part.split("\n", 1) for part in parts[1:])
        assert len(found[name]) == len(parts) - 1, f"a section of {name} stands there twice"
    return found


def anchor(heading):
    return re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-")


def says(body):
    """The words of alerts that a section lists."""
    listed = re.search(r"^Says: (.*?)\.?$\n\n", body, flags=re.M | re.S)
    spans = re.findall(r"`(.*?)`", listed[1].replace("\n", " ")) if listed else []
    return spans


def joined(code):
    """The string literals of C++ code, adjacent ones as one, a line each."""
    code = re.sub(r'"\s*\n?\s*"', "", code)
    return "\n".join(re.findall(LITERAL, code))


def statement(code, at):
    """The statement around `at`, between `;` or braces at the ends of lines."""
    start = max(code.rfind(end, 0, at) for end in (";\n", "{\n", "}\n"))
    stop = code.find(";\n", at)
    return code[start + 1:stop]


def raised(code):
    """The statements that raise alerts of severity high or critical."""
    for match in re.finditer(r"Severity::k(?:Critical|High)\b", code):
        each = statement(code, match.start())
        if not NOT_RAISED.search(each):
            yield each


def alert_problems(files, listed):
    """`files`: {path: code}; `listed`: words of the runbook."""
    every = "\n".join(joined(code) for code in files.values())
    for words in listed:
        if words not in every:
            yield f"no alert says {words!r}"
    for path, code in files.items():
        if not path.startswith(tuple(SERVER)):
            continue
        unknown = {each for each in raised(code)
                   if not any(words in joined(each) for words in listed)}
        expected = ELSEWHERE.get(path, 0)
        if len(unknown) != expected:
            yield (f"{path}: {len(unknown)} alerts without a section, {expected} expected: "
                   + " | ".join(" ".join(each.split())[:160] for each in sorted(unknown)))


def help_of(text):
    """{verb: flags} of the pinned help; the flags of `ripsctl` itself are everybody's."""
    found = {}
    for part in re.split(r"^\$ ripsctl ?", text, flags=re.M)[1:]:
        verb, _, rest = part.partition("--help")
        found[verb.strip()] = set(re.findall(r"^ +(?:-\w,)?(--[\w-]+)", rest, flags=re.M))
    return found


def commands(text):
    """What is typed: lines of code and spans of it that begin with ripsctl."""
    for line in re.findall(r"^    +(ripsctl .*)$", text, flags=re.M):
        yield line.split("  #")[0]
    yield from (" ".join(span.split()) for span in re.findall(r"`(ripsctl\s[^`]*)`", text))


def command_problems(text, verbs):
    for command in commands(text):
        words = shlex.split(command)[1:]
        verb = next((" ".join(words[:n]) for n in (2, 1) if " ".join(words[:n]) in verbs), None)
        if verb is None or (verb != "" and any(each.startswith(verb + " ") for each in verbs)):
            yield f"`{command}`: no such verb"
            continue
        for flag in (word for word in words if word.startswith("--")):
            if flag not in verbs[verb] | verbs[""]:
                yield f"`{command}`: {verb} has no {flag}"


def set_problems(chapter, found, wanted):
    yield from (f"{chapter}: no section {name}" for name in sorted(wanted - found))
    yield from (f"{chapter}: {name} does not exist" for name in sorted(found - wanted))


def rule_problems(text):
    for group in yaml.safe_load(text)["groups"]:
        for rule in group["rules"]:
            wanted = f"{INSTALLED}#{anchor(rule['alert'])}"
            if rule["annotations"].get("runbook") != wanted:
                yield f"{RULES}: {rule['alert']} has no `runbook: {wanted}`"


def read(path):
    return (ROOT / path).read_text(encoding="utf-8")


def check_self():
    """This test finds what it must."""
    verbs = help_of("$ ripsctl --help\n  --server TEXT  x\n$ ripsctl level --help\n"
                    "$ ripsctl level show --help\n  -h,--help x\n  --all  x\n"
                    "$ ripsctl top --help\n")
    good = "    ripsctl level show R --all --server S  # x --bad\n`ripsctl\ntop`\n"
    assert not list(command_problems(good, verbs))
    for bad in ("level look R", "level", "show", "level show R --most", "top --all"):
        assert len(list(command_problems(f"`ripsctl {bad}`", verbs))) == 1, bad
    assert says("Says: `a `;\n` b`.\n\nx `c`\n") == ["a ", " b"]
    raise_ = '{\n  Raise(Severity::kHigh,\n  StrCat("so ",\n  x, "is "\n  "it"));\n}\n'
    path = SERVER[0] + "/x.cc"
    assert not list(alert_problems({path: raise_}, ["is it"]))
    assert len(list(alert_problems({path: raise_}, []))) == 1
    assert len(list(alert_problems({path: raise_}, ["is it", "is not"]))) == 1
    assert len(list(set_problems("c", {"a", "b"}, {"b", "d"}))) == 2
    assert len(list(rule_problems("groups: [{rules: [{alert: A, annotations: {}}]}]"))) == 1


def main():
    check_self()
    page, rules = read(PAGE), read(RULES)
    chapters = sections(page)
    problems = list(rule_problems(rules))
    names = set(re.findall(r"^      - alert: (\w+)$", rules, flags=re.M))
    problems += set_problems("Alerts of Prometheus", set(chapters["Alerts of Prometheus"]), names)
    listed = re.search(r"kFindings\[\] = \{(.*?)\}", read(
        "policy_server/policy/lang/check/signature.cc"), flags=re.S)[1]
    kinds = set(re.findall(r'"(\w+)"', listed))
    problems += set_problems("Findings", set(chapters["Findings"]), kinds)
    own = chapters["Alerts that RIPS raises itself"]
    problems += (f"{name}: no `Says:`" for name, body in own.items() if "Says: " not in body)
    for chapter in (chapters["Alerts of Prometheus"], own):
        problems += (f"{name}: no *{part}:*" for name, body in chapter.items()
                     for part in ("Do", "Lower") if f"*{part}:*" not in body)
    problems += (f"{name}: no *Do:*" for name, body in chapters["Findings"].items()
                 if "*Do:*" not in body)
    files = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for folder in TEXTS
             for path in sorted((ROOT / folder).rglob("*"))
             if path.suffix in (".cc", ".h") and not path.name.endswith("_test.cc")}
    problems += alert_problems(files, [words for body in own.values() for words in says(body)])
    problems += command_problems(page, help_of(read("policy_server/ripsctl/testdata/help.txt")))
    print("\n".join(f"{PAGE}: {problem}" for problem in problems) or f"{len(names)} alerts agree")
    sys.exit(1 if problems else 0)


if __name__ == "__main__":
    main()
