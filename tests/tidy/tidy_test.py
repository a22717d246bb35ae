"""The rules of this tree that compilers do not know, as a test. Prints every breach.

    tidy_test.py TARGETS     targets.txt of a build directory: which files belong to which target
"""

import fnmatch
import functools
import os
import pathlib
import re
import subprocess
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import includes  # noqa: E402
from class_sizes import class_sizes  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
TOP = {"proto", "services", "sensor_agent", "policy_server", "mode_actuator", "deploy", "rules",
       "tests", "README.md", "CONTRIBUTING.md", "LICENSE", "CMakeLists.txt", "CMakePresets.json", ".clang-format",
       ".clang-tidy", ".gitignore", ".ci"}
IMPURE = re.compile(r"#include [<\"](thread|mutex|atomic|fstream|iostream|random|chrono|grpc.*|"
                    r"dds/.*|sqlite3.*|.*\.pb\.h)[>\"]|absl::Now\(|getenv\(")
# A line or file that breaks a rule with a good reason.
ALLOWED = {
    "services/base/fake_clock.h": "an atomic, so that a test's threads may share a stepped clock",
    "sensor_agent/messages/payload_pool.h": "an atomic: payloads are freed on any thread",
    "services/rpc/credentials_test.cc": "runs openssl as a peer that only speaks TLS 1.2",
}
DDS_FOLDERS = ("services/dds/", "sensor_agent/dds/", "tests/support/robot_sim/", "mode_actuator/",
               "tests/support/dds_peer/lawless.cc")
BANNED = [
    (re.compile(r"std::string_view"), "use absl::string_view: there is no conversion either way"),
    (re.compile(r"\babsl::(Mutex|MutexLock|Notification|CondVar)\b"), "use services/runtime/mutex.h"),
    (re.compile(r"std::(mutex|lock_guard|unique_lock|scoped_lock)\b"),
     "use services/runtime/mutex.h"),
    (re.compile(r"\bsystem\(\"|\bpopen\("), "no shell"),
    (re.compile(r"//.*\b(TO[D]O|FIX[M]E|XX[X]|HAC[K])\b"), "finish it or leave it out"),
]
MUTEX_HOME = "services/runtime/mutex"
CC_LINES_MAX = 800
HEADER_LINES_MAX = 250
# Longer, and why.
LONG_HEADERS = {
    "policy_server/policy/engine/test_rules.h": (300, "one fixture of many tests, all inline"),
    "policy_server/ripsctl/ripsctl_fixture.h": (350, "one fixture of many tests, all inline"),
    "policy_server/server/robot/robot_fixture.h": (350, "one fixture of many tests, all inline"),
    "sensor_agent/graph/graph_builder.h": (260, "a third of it says whose an endpoint is"),
}


CLASS_SIZE_MAX = 25


def large_classes():
    """Those listed in large_classes.txt: (file, class) -> how many members and methods at most."""
    listed = (ROOT / "tests/tidy/large_classes.txt").read_text(encoding="utf-8")
    return {(file, name): int(most) for most, file, name in
            re.findall(r"^ *(\d+) (\S+) (\S+): \S", listed, re.M)}


def class_breaches(sizes, listed):
    """`sizes`: (file, class) -> members and methods."""
    for (file, name), size in sizes.items():
        most = listed.get((file, name), CLASS_SIZE_MAX)
        if size > most:
            yield f"{file}: {name} has {size} members and methods, at most {most}; split it by idea"
    for (file, name), most in listed.items():
        size = sizes.get((file, name), 0)
        if size < most:
            yield (f"tests/tidy/large_classes.txt: {name} of {file} has {size} members and methods "
                   f"by now, not {most}")


def walk_breaches(text):
    """Of the walk of one observation in CONTRIBUTING.md: hops that are not where it says."""
    walk = text.partition("## The walk of one observation")[2].partition("\n## ")[0]
    hops = re.findall(r"^\d+\. `([^`]+)`, `(\w+(?:::\w+)+)`", walk, re.M)
    if not 0 < len(hops) <= 12 or len(hops) != len(re.findall(r"^\d+\. ", walk, re.M)):
        yield f"CONTRIBUTING.md: the walk has {len(hops)} hops of the form FILE, FUNCTION; at most 12"
    for file, function in hops:
        path = ROOT / re.sub(r"^server/", "policy_server/server/", file)
        name = function.rpartition("::")[2]
        if not path.is_file() or not re.search(rf"\b{name}\(", path.read_text(encoding="utf-8")):
            yield f"CONTRIBUTING.md: {function} is not in {file}"


def tracked():
    try:
        listed = subprocess.run(["git", "ls-files", "-z", "--cached", "--others",
                                 "--exclude-standard"], cwd=ROOT, capture_output=True, check=True)
        return [name for name in listed.stdout.decode().split("\0")
                if name and (ROOT / name).is_file()]
    except (OSError, subprocess.CalledProcessError):
        pass  # no git, or not a checkout: whatever is there
    files = []
    for folder, below, names in os.walk(ROOT):
        if folder == str(ROOT):
            below[:] = [name for name in below if name not in ("build", ".git")]
        files += [str((pathlib.Path(folder) / name).relative_to(ROOT)) for name in names]
    return files


class Targets:
    """What belongs to which target, and what a target may include."""

    def __init__(self, path):
        self.layers, self.links, self.owners = {}, {}, {}
        for line in pathlib.Path(path).read_text(encoding="utf-8").splitlines():
            name, layer, files, deps = line.split("|")
            self.layers[name] = layer
            self.links[name] = set(deps.split())
            for file in files.split():
                self.owners.setdefault(file, set()).add(name)
                if file.endswith(".cc"):
                    self.owners.setdefault(file[:-3] + ".h", set()).add(name)

    def pure(self, file):
        return any(self.layers[owner] in ("base", "pure", "port")
                   for owner in self.owners.get(file, ()))

    @functools.cache
    def reached(self, target):
        """The targets that `target` links, itself among them."""
        out = {target}
        for dep in self.links.get(target, ()):
            out |= self.reached(dep)
        return out

    def breaches(self, file, lines):
        """Of a file: that it has no target, or includes what its target does not link."""
        owners = self.owners.get(file, set())
        if not owners:
            yield f"{file}: no target names it; a header without a .cc belongs into HDRS"
        for line in lines:
            include = re.match(r'#include "([^"]+\.h)"', line)
            theirs = self.owners.get(include.group(1)) if include else None
            if not theirs:
                continue
            for owner in owners:
                if self.layers[owner] != "test" and not self.reached(owner) & theirs:
                    yield (f"{file}: includes {include.group(1)} of {', '.join(sorted(theirs))}, "
                           f"which {owner} does not link")


def headers_not_listed():
    """Common headers of RipsTargets.cmake that includes.py does not look for."""
    text = (ROOT / "deploy/cmake/RipsTargets.cmake").read_text(encoding="utf-8")
    common = re.search(r"set\(RIPS_COMMON_HEADERS([^)]*)\)", text).group(1)
    for header in re.findall(r"<([^>]+)>", common):
        if header not in includes.HEADERS and header != "utility":
            yield f"tests/tidy/includes.py: no names of <{header}>, which is precompiled"


def breaches(files, targets):
    for top in sorted({name.split("/")[0] for name in files} - TOP):
        yield f"{top}: not a top-level name of this project"
    mentions = "\n".join((ROOT / name).read_text(errors="replace") for name in files
                         if name.endswith(("CMakeLists.txt", ".cmake")))
    sizes = {}
    for name in files:
        if not name.endswith((".h", ".cc")):
            continue
        text = (ROOT / name).read_text(encoding="utf-8")
        lines = text.splitlines()
        if not name.startswith("tests/") and not re.search(r"(test|fixture|fake)[^/]*$", name):
            sizes |= {(name, each): size for each, _, size in class_sizes(text)}
        if not name.startswith(("tests/", "rules/", "deploy/")) and not name.endswith("_test.cc"):
            yield from targets.breaches(name, lines)
        for used, header in includes.missing(name):
            yield f"{name}: uses {used} and does not include {header}, nor does a header of ours"
        limit = CC_LINES_MAX if name.endswith(".cc") else HEADER_LINES_MAX
        limit, _ = LONG_HEADERS.get(name, (limit, ""))
        if len(lines) > limit:
            yield f"{name}: {len(lines)} lines exceed the limit of {limit}; split it by idea"
        if name.endswith(".h"):
            guard = "RIPS_" + re.sub(r"[/.]", "_", name).upper() + "_"
            if not any(line == f"#ifndef {guard}" for line in lines):
                yield f"{name}: the include guard must be {guard}"
        elif pathlib.Path(name).name not in mentions:
            yield f"{name}: no CMakeLists.txt names it"
        for number, line in enumerate(lines, 1):
            if len(line) > 100 and "http" not in line and not name.startswith("tests/fuzz/corpus"):
                # A string literal may have to be long, a test's raw text too.
                if '"' not in line and not name.endswith("_test.cc"):
                    yield f"{name}:{number}: {len(line)} columns exceed 100"
            if not name.startswith(MUTEX_HOME) and name not in ALLOWED:
                for pattern, why in BANNED:
                    if pattern.search(line):
                        yield f"{name}:{number}: {pattern.pattern}: {why}"
            if "#include \"dds/" in line and not name.startswith(DDS_FOLDERS):
                yield f"{name}:{number}: only the DDS adapters include dds/*.h"
            if targets.pure(name) and name not in ALLOWED and IMPURE.search(line):
                yield f"{name}:{number}: a pure file must not: {line.strip()}"
    yield from headers_not_listed()
    yield from class_breaches(sizes, large_classes())
    yield from walk_breaches((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))


def verbs_without_maker(files):
    """A verb of ripsctl that its file does not add to a noun: it compiles, and cannot be called."""
    texts = {name: (ROOT / name).read_text(encoding="utf-8") for name in files
             if name.startswith("policy_server/ripsctl/") and name.endswith((".h", ".cc"))}
    bases, finals = {}, []
    for name, text in texts.items():
        for verb, final, base in re.findall(r"^class (\w+)( final)?\s*: public ([\w:]+)", text,
                                            re.M):
            bases[verb] = base
            if final and name.endswith(".cc"):
                finals.append((name, verb))
    for name, verb in finals:
        base = verb
        while base in bases:
            base = bases[base]
        if base == "Command" and not re.search(rf"MakeCommands<[^;]*\b{verb}\b", texts[name]):
            yield f"{name}: nothing makes the verb {verb}; add it to the ...Commands of its noun"


def filters_without_test(files):
    """A --gtest_filter of CONTRIBUTING.md that matches no test."""
    tests = {".".join(test) for name in files if name.endswith("_test.cc")
             for test in re.findall(r"\bTEST(?:_F|_P)?\(\s*(\w+)\s*,\s*(\w+)\s*\)",
                                    (ROOT / name).read_text(encoding="utf-8"))}
    page = "CONTRIBUTING.md"
    for number, line in enumerate((ROOT / page).read_text(encoding="utf-8").splitlines(), 1):
        for pattern in re.findall(r"--gtest_filter='?([^'\s]+)", line):
            if not any(fnmatch.fnmatchcase(test, pattern) for test in tests):
                yield f"{page}:{number}: no test matches --gtest_filter='{pattern}'"


def main():
    files = tracked()
    found = [*breaches(files, Targets(sys.argv[1])), *verbs_without_maker(files),
             *filters_without_test(files)]
    for breach in found:
        print(breach)
    print(f"{len(files)} files, {len(found)} breaches")
    return 1 if found or not files else 0


if __name__ == "__main__":
    sys.exit(main())
