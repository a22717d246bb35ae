"""What the manuals say is so: rules/LANGUAGE.md, rules/PROTOTYPE.md, README.md and deploy/handbook.

    manual_test.py RIPSCTL            checks; prints every breach
    manual_test.py RIPSCTL --update   rewrites the generated reference and what commands print; the
                                      diff is to be reviewed

Blocks, by what stands behind their three backticks; all of a page share one directory:

    rul [file=NAME]        a rule file: accepted, without warnings. NAME is policy.rul by default
    rul part               the same, with levels DEFAULT, ALERT soft, COMPROMISED, HALT around it
    rul error=A,B          refused with exactly these kinds of diagnostics
    rul warning=A,B        accepted with exactly these
    yaml test [file=NAME]  unit tests for `ripsctl rules test`: all pass
    console                `$ ripsctl ...` lines, each followed by exactly what it prints, and
                           `$ echo $?` by its exit code; `$ mkdir` and `$ cp` are done, too
    LANGUAGE file=NAME     any other file; with `run`, one that may be executed
    yaml                   only shown; it parses
    sh, text, json         only shown
"""

import json
import pathlib
import re
import shlex
import struct
import subprocess
import sys
import tempfile

import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/support"))
from pages import user_pages  # noqa: E402

PAGES = ["rules/LANGUAGE.md", "rules/PROTOTYPE.md", *user_pages()]
SHOWN = {"sh", "text", "json"}
LEVELS = "levels: DEFAULT; ALERT soft; COMPROMISED; HALT;\n"
REACHED = "\nrules External: false ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);\n"
BEGIN = "<!-- generated: ripsctl rules builtins --markdown -->\n"
END = "<!-- end of generated -->\n"
LIMITS = ("## Limits", "policy_server/policy/lang/limits.h")


class Block:
    def __init__(self, page, line, info, text):
        words = info.split()
        self.where = f"{page}:{line}"
        self.language = words[0] if words else ""
        self.words = {word for word in words[1:] if "=" not in word}
        self.values = dict(word.split("=", 1) for word in words[1:] if "=" in word)
        self.text = text

    def kinds(self, what):
        return set(filter(None, self.values.get(what, "").split(",")))


def blocks_of(page, text):
    found, info, start, body = [], None, 0, []
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("```"):
            if info is None:
                info, start, body = line[3:].strip(), number, []
            else:
                found.append(Block(page, start, info, "".join(body)))
                info = None
        elif info is not None:
            body.append(line + "\n")
    assert info is None, f"{page}:{start}: the block does not end"
    return found


class Manual:
    def __init__(self, ripsctl, folder, update):
        self.update = update
        # Old and new texts of console blocks.
        self.updates = []
        self.ripsctl = str(pathlib.Path(ripsctl).resolve())
        self.folder = pathlib.Path(folder)
        self.problems = []

    def run(self, *args):
        done = subprocess.run([self.ripsctl, *args], cwd=self.folder, capture_output=True, text=True,
                              timeout=60, env={"HOME": str(self.folder), "PATH": "/usr/bin:/bin"})
        return done.returncode, done.stdout, done.stderr

    def fail(self, block, text):
        self.problems.append(f"{block.where}: {text}")

    def save(self, block, default, text=None):
        path = self.folder / block.values.get("file", default)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.text if text is None else text, encoding="utf-8")
        path.chmod(0o755 if "run" in block.words else 0o644)
        return str(path.relative_to(self.folder))

    def rules(self, block):
        part = "part" in block.words
        name = self.save(block, "policy.rul",
                         LEVELS + block.text + REACHED if part else block.text)
        code, out, err = self.run("rules", "check", "--output", "json", name)
        if code not in (0, 1):
            return self.fail(block, f"ripsctl says: {err}")
        said = {"error": set(), "warning": set(), "note": set()}
        for diagnostic in json.loads(out)["files"][0]["diagnostics"]:
            said[diagnostic["severity"]].add(diagnostic["kind"])
        for severity in ("error", "warning"):
            if said[severity] != block.kinds(severity):
                self.fail(block, f"{severity}s are {sorted(said[severity])}, the page says "
                                 f"{sorted(block.kinds(severity))}\n"
                          + self.run("rules", "check", name)[1])

    def tests(self, block):
        code, out, err = self.run("rules", "test", self.save(block, "policy_test.yaml"))
        if code != 0:
            self.fail(block, out + err)

    def console(self, block):
        steps = []
        for line in block.text.splitlines():
            if line.startswith("$ "):
                steps.append((line[2:], []))
            elif steps:
                steps[-1][1].append(line)
            else:
                return self.fail(block, "output before any command")
        code, fresh = None, ""
        for command, lines in steps:
            if command == "echo $?":
                out = f"{code}\n"
            else:
                words = shlex.split(command)
                if words[0] in ("mkdir", "cp"):
                    done = subprocess.run(words, cwd=self.folder, capture_output=True, text=True)
                    code, out, err = done.returncode, done.stdout, done.stderr
                elif words[0] == "ripsctl":
                    code, out, err = self.run(*words[1:])
                else:
                    return self.fail(block, f"cannot run {words[0]}")
                out += err
            expected = "".join(line + "\n" for line in lines)
            # Trailing blanks are not to be had in a page.
            out = "".join(line.rstrip() + "\n" for line in out.splitlines())
            fresh += f"$ {command}\n{out}"
            if out != expected and not self.update:
                self.fail(block, f"$ {command}\nprints:\n{out}the page says:\n{expected}")

        if fresh != block.text and self.update:
            self.updates.append((f"```console\n{block.text}```", f"```console\n{fresh}```"))

    def ask(self, block, name):
        """The plugin of the manual answers as the page says it does."""
        header = b'{"payload_bytes":3}'
        question = b"".join(struct.pack("<I", len(header)) + header + payload
                            for payload in (b"AAA", b"aaa"))
        done = subprocess.run([str(self.folder / name)], input=question, capture_output=True,
                              timeout=60, env={"PATH": "/usr/bin:/bin"})
        if done.stdout != b"rips-plugin 1\n1\n0\n":
            self.fail(block, f"the plugin answers {done.stdout!r} {done.stderr!r}")

    def block(self, block):
        if block.language == "rul":
            self.rules(block)
        elif block.language == "yaml" and "test" in block.words:
            self.tests(block)
        elif block.language == "console":
            self.console(block)
        elif "file" in block.values:
            name = self.save(block, "")
            if "plugin" in block.words:
                self.ask(block, name)
        elif block.language == "yaml":
            try:
                yaml.safe_load(block.text)
            except yaml.YAMLError as error:
                self.fail(block, f"this is no YAML: {error}")
        elif block.language not in SHOWN:
            self.fail(block, f"what is a block of `{block.language}`?")


def limits(page, text):
    """Every limit of the header stands in the table, with its value."""
    heading, header = LIMITS
    if heading not in text:
        yield f"{page}: no section {heading}"
        return
    section = text.split(heading + "\n")[1].split("\n## ")[0]
    source = (ROOT / header).read_text(encoding="utf-8").replace("\n", " ").replace("'", "")
    for name, value in re.findall(r"constexpr \w+ (\w+) = ([^;]+);", source):
        value = re.sub(r"(size_t|int64_t)\{(\d+)\}", r"\2", value)
        number = 1
        if "<<" in value:
            left, right = value.split("<<")
            number = int(left) << int(right)
        else:
            number = int(value)
        spelled = [f"{number:,}"]
        if number % (1 << 20) == 0:
            spelled.append(f"{number >> 20} MiB")
        if not any(re.search(rf"(?<![\d,]){re.escape(one)}(?![\d,])", section) for one in spelled):
            yield f"{page}: {heading} does not say {spelled[0]} ({name})"


def main():
    ripsctl, update = sys.argv[1], "--update" in sys.argv[2:]
    problems, count = [], 0
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory(prefix="rips-manual-") as folder:
            manual = Manual(ripsctl, folder, update)
            if BEGIN in text:
                before, rest = text.split(BEGIN)
                generated, after = rest.split(END)
                fresh = manual.run("rules", "builtins", "--markdown")[1]
                fresh = "\n" + re.sub(r"(?m)^## ", "### ", fresh) + "\n"
                if update and fresh != generated:
                    text = before + BEGIN + fresh + END + after
                elif fresh != generated:
                    problems.append(f"{page}: the reference is not what `ripsctl rules builtins "
                                    "--markdown` prints; run manual_test.py RIPSCTL --update")
            for block in blocks_of(page, text):
                manual.block(block)
                count += 1
            problems += manual.problems
            for old, new in manual.updates:
                text = text.replace(old, new, 1)
            if update:
                (ROOT / page).write_text(text, encoding="utf-8")
        if page == PAGES[0]:
            problems += limits(page, text)
            if BEGIN not in text:
                problems.append(f"{page}: no generated reference")
    print("\n".join(problems))
    print(f"{count} blocks, {len(problems)} problems")
    return 1 if problems or count == 0 else 0


if __name__ == "__main__":
    sys.exit(main())
