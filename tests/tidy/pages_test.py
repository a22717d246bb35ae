"""The pages for users and maintainers: lengths, widths, links, and the commands of README.md and
deploy/handbook.

A command of ripsctl must name a verb and flags that its pinned --help has; the test `recipes` holds
that each verb has a test. Any other command must be run by the test of its section (RUN of
tests/support/pages.py), or be of a program of ours whose source has its words, or be listed in
NOT_RUN with the reason. README.md shows only commands that the handbook shows, too.
"""

import pathlib
import re
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(ROOT / "tests/support")]
import pages  # noqa: E402
from runbook_test import command_problems, help_of  # noqa: E402

LINES_MAX = {"README.md": 150}
PAGE_LINES_MAX = 250  # of the handbook, and of DESIGN pages
COLUMNS_MAX = 100  # of README.md and the handbook, tables too
DESIGN_COLUMNS_MAX = 120  # of DESIGN pages, except in tables
HANDBOOK = {"install", "certificates", "fleet", "rules", "rollout", "coverage", "operate", "alerts",
            "monitoring", "audit", "containers", "programs", "faults"}
HELP = "policy_server/ripsctl/testdata/help.txt"
# Pages whose spans of code name verbs of ripsctl; those of LANGUAGE.md and RUNBOOK.md have tests of
# their own.
SPEAKS = ["policy_server/METRICS.md", "policy_server/audit/FORMAT.md", "deploy/EXPERIMENT.md"]
# Where the subcommands and flags of our other programs are.
DAEMON = ["services/runtime/daemon_flags.cc"]
SOURCES = {
    "rips-mint": ["deploy/pki/mint"],
    "rips-enrol": ["services/enrol/main.cc"],
    "rips-policy-server": DAEMON,
    "rips-sensor": DAEMON,
    "rips-actuator": DAEMON,
}
# How many words after the flags are the program's own; the others name robots, hosts and files.
OWN_WORDS = {"rips-mint": 1, "rips-enrol": 1}
# Commands that no test runs, word by word, and why.
NOT_RUN = {
    "docker load -i build/images/rips-policy-server_0.1.0.tar": "no container engine in CI",
    "docker compose -f deploy/compose.yaml up -d": "the test `images` starts what the file says",
    "docker compose -f deploy/compose.yaml --profile robot up -d sensor actuator": "the same",
    "docker compose -f deploy/compose.yaml run --rm policy-server --check-config": "the same",
    "systemctl enable --now rips-enrol-renew.timer": "the test `packages_boot` starts the service",
    "systemctl reload rips-policy-server": "ExecReload=; scenarios send SIGHUP themselves",
    "systemctl status rips-policy-server": "of systemd alone",
    "curl -s http://127.0.0.1:9464/readyz": "scenarios ask for the same path",
    "curl -s http://127.0.0.1:9464/metrics": "the same",
    "source <(ripsctl completion bash)": "the tests of ripsctl load the completion",
}
# A section in words, in any file: (FILE.md, "Section") or ("Section" in FILE.md).
SECTION_AFTER = re.compile(r"([\w./-]+\.md|README),\s+\\?\"([^\"\\\n]+)\\?\"")
SECTION_BEFORE = re.compile(r"\"([^\"\\\n]+)\"\s+(?:in|of) ([\w./-]+\.md)")


def tracked(*patterns):
    done = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard",
                           *patterns], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:  # a tree without git
        found = {path for pattern in patterns or ("*",) for path in ROOT.glob(f"**/{pattern}")
                 if not {"build", ".git"} & set(path.relative_to(ROOT).parts)}
        return sorted(str(path.relative_to(ROOT)) for path in found if path.is_file())
    return sorted(name for name in set(done.stdout.split("\0")) if name and (ROOT / name).is_file())


def is_design(page):
    """DESIGN.md, and a page beside the code that it describes."""
    return page.endswith(".md") and page.startswith(
        ("policy_server/", "sensor_agent/", "mode_actuator/", "services/")) and \
        pathlib.PurePath(page).name not in ("METRICS.md", "FORMAT.md")


def size_problems(page, text, user):
    lines = text.splitlines()
    most = LINES_MAX.get(page, PAGE_LINES_MAX)
    if len(lines) > most:
        yield f"{page}: {len(lines)} lines, at most {most}"
    columns = COLUMNS_MAX if user else DESIGN_COLUMNS_MAX
    for number, line in enumerate(lines, 1):
        if len(line) > columns and (user or not line.lstrip().startswith("|")):
            yield f"{page}:{number}: {len(line)} columns, at most {columns}"


def anchors(text):
    """Of the headings, as GitHub makes them: the second of one name ends in -1."""
    found, seen = set(), {}
    for heading in re.findall(r"^#{1,6} +(.+?) *#*$", pages.without_fences(text), re.M):
        heading = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        base = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        count = seen.get(base, 0)
        seen[base] = count + 1
        found.add(f"{base}-{count}" if count else base)
    found.update(re.findall(r"<a (?:id|name)=\"([^\"]+)\"", text))
    return found


def link_problems(page, text, read):
    """`read` gives the text of a path below ROOT, True for a directory, None for neither."""
    prose = re.sub(r"(`+).+?\1", "", pages.without_fences(text))
    targets = re.findall(r"\]\(\s*([^)\s]+)[^)]*\)", prose)
    targets += re.findall(r"^\[[^\]]+\]: +(\S+)", prose, re.M)
    targets += re.findall(r"(?:src|srcset|href)=\"([^\"]+)\"", prose)
    for target in targets:
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        place = page if not path else str(pathlib.PurePosixPath(page).parent / path)
        parts = []
        for part in place.split("/"):
            if part == "..":
                parts = parts[:-1]
            elif part not in (".", ""):
                parts.append(part)
        found = read("/".join(parts))
        if found is None:
            yield f"{page}: no {target}"
        elif anchor and (found is True or anchor not in anchors(found)):
            yield f"{page}: no heading for {target}"


def section_problems(name, text, headings):
    """Sections that a file names in words; `headings`: {page: its headings}, by path and name."""
    named = SECTION_AFTER.findall(text)
    named += [(page, section) for section, page in SECTION_BEFORE.findall(text)]
    for page, section in named:
        page = "README.md" if page == "README" else page
        if page in headings and section not in headings[page]:
            yield f"{name}: {page} has no section \"{section}\""


def has_word(source, word):
    """`--flag=x` and `verb` in a usage text, or as a string of C++ without or with its dashes."""
    word = word.split("=")[0]
    return re.search(rf"(?<![\w-]){re.escape(word)}(?![\w-])", source) is not None


def program_problems(command, sources):
    """Of `rips-enrol fetch --token FILE` and the like."""
    words = command.split()
    program = words[0]
    source = sources[program]
    yield from (f"`{command}`: {program} has no {word}" for word in words[1:]
                if word.startswith("--") and not has_word(source, word))
    rest, skip = [], False
    for word in words[1:]:
        if skip or word.startswith("--"):
            # All flags of these programs but the last ones have a value.
            skip = not skip and "=" not in word
            continue
        rest.append(word)
    yield from (f"`{command}`: {program} has no {word}" for word in rest[:OWN_WORDS.get(program, 0)]
                if not has_word(source, word))


def script_problem(command, script_of):
    """Of ./deploy/demo --keep and the like; `script_of` gives the text of a program or None."""
    words = command.split()
    text = script_of(words[0].removeprefix("./"))
    if text is None:
        yield f"`{command}`: no such program"
        return
    yield from (f"`{command}`: it has no {word}" for word in words[1:]
                if word.startswith("--") and not has_word(text, word))


def command_breaches(page, text, run, verbs, sources, script_of, used):
    """Of all commands of a page. `run`: those that tests run. Adds those of NOT_RUN to `used`."""
    for line, _, command in pages.commands(text):
        where = f"{page}:{line}"
        if command in NOT_RUN:
            used.add(command)
            continue
        inner = command.partition(" -- ")[2] if command.startswith("runuser ") else command
        first = inner.split()[0]
        if first.endswith("ripsctl"):
            bare = re.sub(r"^\S*ripsctl --(context|output) \S+", "ripsctl", command)
            bare = re.split(r" [|>] ", bare)[0].replace("<(", "")
            spoken = "`ripsctl" + bare[bare.index("ripsctl") + 7:] + "`\n"
            yield from (f"{where}: {problem}" for problem in command_problems(spoken, verbs))
        elif first in sources:
            yield from (f"{where}: {problem}" for problem in program_problems(inner, sources))
        elif first.startswith(("./", "tests/", "deploy/")):
            yield from (f"{where}: {problem}" for problem in script_problem(command, script_of))
        elif command not in run:
            yield (f"{where}: no test runs `{command}`: see RUN of tests/support/pages.py, and "
                   "NOT_RUN here")


def span_breaches(page, text, verbs):
    """Spans of code: `ripsctl level show`, and `level show` alone if `level` is a noun of it."""
    prose = pages.without_fences(text)
    spans = [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", prose)]
    for span in spans:
        if re.match(r"ripsctl [^-|<]", span):
            bare = re.split(r" [|>] ", re.sub(r"^ripsctl --\S+ \S+", "ripsctl", span))[0]
            yield from (f"{page}: {problem}" for problem in command_problems(f"`{bare}`\n", verbs))
    nouns = {verb.split()[0] for verb in verbs if " " in verb}
    for span in spans:
        words = re.fullmatch(r"([a-z]+) ([a-z]+(?:-[a-z]+)*)(?: .*)?", span)
        if words and words[1] in nouns and f"{words[1]} {words[2]}" not in verbs:
            yield f"{page}: `{span}`: no such verb"


def excerpt_breaches(text, shown):
    """Commands of README.md that no page of the handbook shows, but for programs of this tree."""
    for line, _, command in pages.commands(text):
        if command not in shown and not command.startswith(("./", "build/")):
            yield f"README.md:{line}: no page of the handbook shows `{command}`"


def begins_with_commands(page, text):
    head = text.partition("\n## ")[0]
    if not re.match(r"# .+\n\n\S", head):
        yield f"{page}: begins with its title and a sentence"
    elif not list(pages.commands(head)):
        yield f"{page}: its commands come before its first section"


def verbs_of_help():
    verbs = help_of(pages.read(HELP))
    verbs["man"] = set()  # hidden from --help
    return verbs


def place(path):
    found = ROOT / path
    if found.is_dir():
        return True
    if not found.is_file():
        return None
    return found.read_text(encoding="utf-8") if path.endswith(".md") else ""


def program_text(path):
    found = ROOT / path
    executable = found.is_file() and found.stat().st_mode & 0o111
    return found.read_text(encoding="utf-8") if executable else None


def check_self():
    """This test finds what it must."""
    def count(problems):
        return len(list(problems))
    long = "x\n" * 151
    assert count(size_problems("README.md", long, True)) == 1
    assert count(size_problems("a/DESIGN.md", long + "| " + "x" * 150, False)) == 0
    assert count(size_problems("a/DESIGN.md", "x" * 121, False)) == 1
    assert count(size_problems("deploy/handbook/x.md", "x" * 101 + "\n" * 251, True)) == 2
    page = "# A `b` c.d\n## Twice\n## Twice\n```\n# no\n```\n"
    assert anchors(page) == {"a-b-cd", "twice", "twice-1"}, anchors(page)
    tree = {"d/a.md": page, "d/b.md": "# Here", "d": True}.get
    good = "[x](a.md#twice-1) [y](#here) `[z](no.md)` [w](../d/b.md) [u](https://x/y)\n# Here\n"
    assert not list(link_problems("d/b.md", good, tree))
    for bad in ("[x](c.md)", "[x](a.md#thrice)", "[x](a.md#no)", "[x](#there)", "[x][1]\n[1]: c.md",
                "<img src=\"c.svg\">"):
        assert count(link_problems("d/b.md", bad, tree)) == 1, bad
    words = "README.md, \"Install\"; README.md, \"No\"; \"Not\" in README.md"
    assert count(section_problems("x.cc", words, {"README.md": {"Install"}})) == 2
    verbs = help_of("$ ripsctl --help\n$ ripsctl level --help\n$ ripsctl level show --help\n"
                    "  --all  x\n")
    sources = {"rips-x": '"fetch" --token "--check-config"'}
    scripts = {"deploy/x": "--keep"}.get

    def of(command):
        text = f"## S\n\n    {command}\n"
        return count(command_breaches("p.md", text, {"cp a b"}, verbs, sources, scripts, set()))
    for right in ("ripsctl level show R --all   # x", "rips-x --check-config", "./deploy/x --keep",
                  "runuser -u u -- rips-x --check-config", "ripsctl level show R > file",
                  "cp a b"):
        assert of(right) == 0, right
    for wrong in ("ripsctl level look R", "ripsctl level show R --most", "rips-x --no-config",
                  "./deploy/y", "./deploy/x --leave", "install a b"):
        assert of(wrong) == 1, wrong
    assert count(span_breaches("p.md", "`ripsctl level look R` `level look` `level show R`",
                               verbs)) == 2
    assert count(excerpt_breaches("\n    ripsctl a\n    ripsctl b\n", {"ripsctl a"})) == 1
    assert count(begins_with_commands("p", "# A\n\nDo it.\n\n## B\n\n    ripsctl a\n")) == 1


def main():
    check_self()
    verbs, used, shown, problems = verbs_of_help(), set(), set(), []
    sources = {name: "\n".join(pages.read(path) for path in paths)
               for name, paths in SOURCES.items()}
    users = pages.user_pages()
    run = set()
    for page, sections in pages.RUN.items():
        missing = pages.missing_sections(page)
        problems += (f"{page}: no section {name}, whose commands a test runs" for name in missing)
        for test in set() if missing else set(sections.values()):
            run |= set(pages.commands_that(test, page))
    names = {pathlib.PurePath(page).stem for page in users[1:]}
    problems += (f"{pages.HANDBOOK}: no {name}.md" for name in sorted(HANDBOOK - names))
    for page in users:
        text = pages.read(page)
        problems += size_problems(page, text, True)
        problems += command_breaches(page, text, run, verbs, sources, program_text, used)
        problems += span_breaches(page, text, verbs)
        if page != "README.md":
            problems += begins_with_commands(page, text)
            shown |= {command for _, _, command in pages.commands(text)}
            if f"({page})" not in pages.read("README.md"):
                problems.append(f"README.md: no link to {page}")
    problems += excerpt_breaches(pages.read("README.md"), shown)
    problems += (f"NOT_RUN: no page shows `{command}`" for command in sorted(set(NOT_RUN) - used))
    for page in SPEAKS:
        problems += span_breaches(page, pages.read(page), verbs)
    all_pages = tracked("*.md")
    for page in all_pages:
        text = pages.read(page)
        problems += link_problems(page, text, place)
        if is_design(page):
            problems += size_problems(page, text, False)
    headings = {page: set(re.findall(r"^#+ +(.+?) *$", pages.without_fences(pages.read(page)),
                                     re.M)) for page in all_pages}
    for name in tracked():
        path = ROOT / name
        if path.suffix in (".svg", ".bag", ".db3") or name == "tests/tidy/pages_test.py":
            continue
        problems += section_problems(name, path.read_bytes().decode("utf-8", "ignore"), headings)
    print("\n".join(problems) or f"{len(users)} pages for users and {len(all_pages) - len(users)} "
          "others agree")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
