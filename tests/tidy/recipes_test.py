"""The places that CONTRIBUTING.md's recipes name and that no compiler sees, as a test.

A new builtin, kind of finding, alarm driver, verb or operator call must stand in each of them.
Prints every place that one is missing from.
"""

import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
# The words of the paper's language and of the prototype. A policy cannot use them as names of its
# own; it may do so with any later word, so that a new release breaks no policy.
PAPER = set("""
    topicin topicmatches publishercount subscribercount publishersinclude subscribersinclude
    publishers subscribers msgtypein msgsubtype payload plugin nodes topics services
    topicpublishers topicsubscribers nodecount topiccount servicecount topicpublishercount
    topicsubscribercount service nodesinclude topicsinclude servicesinclude topicpublishersinclude
    topicsubscribersinclude idsalert signal levelname string eval""".split())
# Alarms that answer nothing, so that there is nothing to decode.
SILENT_ALARMS = {"lcus", "luxafor"}


def read(*patterns):
    """All files that match, one after the other."""
    files = [path for pattern in patterns for path in sorted(ROOT.glob(pattern))]
    assert files, f"no file is called {' or '.join(patterns)}"
    return "\n".join(path.read_bytes().decode("utf-8", "replace") for path in files)


def file_comment(text):
    """What stands above a header's include guard."""
    return text.partition("#ifndef")[0]


def missing(kind, names, places):
    """`places`: (where, text, pattern of a name) in which each name must be found."""
    assert names, f"no {kind} found: the recipe's first place was moved"
    for name in names:
        for where, text, pattern in places:
            if not re.search(pattern(re.escape(name)), text):
                yield f"{kind} {name}: missing from {where}"


def word(name):
    return rf"(?<![\w-]){name}(?![\w-])"


def quoted(name):
    return f'"{name}"'


def call(name):
    return rf"\b{name}\("


def table_row(name):
    return rf"\| `?{name}`? +\|"


def builtins():
    rows = re.findall(r'^RIPS_(?:BUILTIN|QUESTION)\(\w+, "(\w+)",[^"]*?\b(kPaper|kExtension)\b',
                      read("policy_server/policy/lang/builtin.def"), re.M)
    names = [name for name, _ in rows]
    yield from missing("builtin", names, [
        ("tests/fuzz/corpus/lang", read("tests/fuzz/corpus/lang/*"), call),
        ("tests/fuzz/corpus/engine", read("tests/fuzz/corpus/engine/*"), call),
    ])
    for name, origin in rows:
        if origin == "kPaper" and name not in PAPER:
            yield (f"builtin {name}: no word of the paper's language; write kExtension in its row "
                   "of lang/builtin.def, so that policies which use the name go on to compile")


def findings():
    own = re.findall(r'"(\w+)"', re.search(r"kKindNames\[\] = \{(.*?)\}",
                                           read("sensor_agent/findings/findings.cc"), re.S)[1])
    named = re.findall(r'"(\w+)"', re.search(r"kFindings\[\] = \{(.*?)\}",
                                             read("policy_server/policy/lang/check/signature.cc"),
                                             re.S)[1])
    tap = [kind for kind in named if kind not in own]
    yield from missing("finding", own, [
        ("the table in sensor_agent/findings/findings.h",
         file_comment(read("sensor_agent/findings/findings.h")), table_row),
        ("sensor_agent/findings/findings_test.cc",
         read("sensor_agent/findings/findings_test.cc"), quoted),
        ("a test on DDS (sensor_agent/findings_dds_test.cc, tests/integration)",
         read("sensor_agent/*dds_test.cc", "tests/integration/*.py"), quoted),
    ])
    yield from missing("finding of the tap", tap, [
        ("the table in sensor_agent/wire/wire_watch.h",
         file_comment(read("sensor_agent/wire/wire_watch.h")), table_row),
        ("sensor_agent/wire/wire_watch_test.cc", read("sensor_agent/wire/wire_watch_test.cc"),
         quoted),
        ("the table in sensor_agent/wire/DESIGN.md", read("sensor_agent/wire/DESIGN.md"),
         table_row),
        ("tests/integration/wire_test.py", read("tests/integration/wire_test.py"), quoted),
    ])


def alarms():
    state = read("mode_actuator/decide/alarm_state.h")
    rows = re.findall(r'\{AlarmKind::(k\w+), "(\w+)"', state)
    # The compiler sees only that there are kAlarmKindCount.
    yield from missing("alarm kind", re.findall(
        r"k\w+", re.search(r"enum class AlarmKind \{(.*?)\}", state, re.S)[1]), [
            ("kAlarmKinds in mode_actuator/decide/alarm_state.h",
             " ".join(kind for kind, _ in rows), word)])
    kinds = [name for _, name in rows]
    folder = "mode_actuator/steps/alarm"
    yield from missing("alarm kind", kinds, [
        (f"the table in {folder}/drivers.h", file_comment(read(f"{folder}/drivers.h")), table_row),
        (f"{folder}/alarm_config_test.cc", read(f"{folder}/alarm_config_test.cc"), word),
        (f"{folder}/DESIGN.md", read(f"{folder}/DESIGN.md"), word),
        ("the comment in deploy/config/actuator.yaml", read("deploy/config/actuator.yaml"), word),
    ])
    yield from missing("alarm kind", [kind for kind, _ in rows], [
        (f"{folder}/hid_alarm_test.cc or tty_alarm_test.cc",
         read(f"{folder}/hid_alarm_test.cc", f"{folder}/tty_alarm_test.cc"), word),
    ])
    decoders = re.findall(r"^\S.*\b(Decode\w+)\(", read(f"{folder}/frames.h"), re.M)
    yield from missing("decoder", decoders, [
        (f"{folder}/frames_test.cc", read(f"{folder}/frames_test.cc"), call),
        ("tests/fuzz/alarm_fuzz.cc", read("tests/fuzz/alarm_fuzz.cc"), call),
    ])
    seeds = "\n".join(path.name for path in (ROOT / "tests/fuzz/corpus/alarm").iterdir())
    yield from missing("alarm kind", [kind for kind in kinds if kind not in SILENT_ALARMS], [
        ("tests/fuzz/corpus/alarm (a seed whose name begins with it, or SILENT_ALARMS here)",
         seeds, lambda name: rf"(?m)^{name}[._]"),
    ])


def verbs():
    lines = re.findall(r"^\$ ripsctl (\S.*) --help", read("policy_server/ripsctl/testdata/help.txt"),
                       re.M)
    nouns = {line.split()[0] for line in lines if " " in line}
    # `robot` alone only lists its verbs.
    spoken = [line for line in lines if " " in line or line not in nouns]
    tests = read("policy_server/ripsctl/**/*_test.cc")
    # A call of it that is refused is no test of what it does.
    tests, refusals = re.subn(r"^TEST_F\(RipsctlHelpTest, EveryVerbThatItNames.*?^\}$", "", tests,
                              flags=re.M | re.S)
    assert refusals == 1, "the test of refused calls was renamed"
    tests = re.sub(r'",\s*"', " ", tests)
    # The tests of a folder may add the noun.
    short = {line for line in spoken for path in
             ROOT.glob(f"policy_server/ripsctl/{line.split()[0]}/*_test.cc")
             if quoted(line.split()[-1]) in path.read_text(encoding="utf-8")}
    yield from missing("verb", [line for line in spoken if line not in short], [
        ("the tests of ripsctl", tests, lambda name: f'"{name}[ "]'),
    ])
    yield from missing("verb", spoken, [
        ("deploy/handbook or rules/LANGUAGE.md",
         read("deploy/handbook/*.md", "rules/LANGUAGE.md"),
         lambda name: rf"ripsctl {name}\b"),
    ])
    makers = re.findall(r"^Commands (\w+)\(\)", read("policy_server/ripsctl/commands.h"), re.M)
    yield from missing("commands", makers, [
        ("kMakers of policy_server/ripsctl/app.cc", read("policy_server/ripsctl/app.cc"), word),
    ])


def calls():
    folder = "policy_server/server/operator_api"
    spoken = re.findall(r"^ *rpc (\w+)\(", read("proto/rips/v1/operator.proto"), re.M)
    streams = re.findall(r"^ *rpc (\w+)\([^)]*\) returns \(stream", read(
        "proto/rips/v1/operator.proto"), re.M)
    roles = file_comment(read(f"{folder}/operator_service.h"))
    yield from missing("call", spoken, [
        (f"the table of roles in {folder}/operator_service.h", roles, word),
        ("FakeOperator in policy_server/ripsctl (ripsctl_fixture.h, fake_rules_operator.h, fake_enrol_operator.h)",
         read("policy_server/ripsctl/ripsctl_fixture.h",
              "policy_server/ripsctl/fake_rules_operator.h",
              "policy_server/ripsctl/fake_enrol_operator.h"), word),
    ])
    viewers = re.search(r"role\n(.*?)viewer\n", roles, re.S)[1]
    ordered = [name for name in spoken if not re.search(word(name), viewers)]
    yield from missing("call", sorted({*streams, *ordered}), [
        (f"the table of uses in {folder}/caller_quota.h",
         file_comment(read(f"{folder}/caller_quota.h")), word),
    ])


def main():
    breaches = [breach for recipe in (builtins, findings, alarms, verbs, calls)
                for breach in recipe()]
    for breach in breaches:
        print(breach)
    return 1 if breaches else 0


if __name__ == "__main__":
    sys.exit(main())
