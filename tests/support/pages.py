"""The commands of the pages for users: README.md and deploy/handbook.

A command is a line of a block that is indented by four columns (by seven in a numbered list),
without its comment; a line that ends in a backslash continues in the next.
"""

import pathlib
import re

ROOT = pathlib.Path(__file__).resolve().parents[2]
HANDBOOK = "deploy/handbook"
# {page: {section: the ctest that runs its commands}}
RUN = {
    f"{HANDBOOK}/install.md": {
        "Certificates": "packages",
        "Server": "packages",
        "Robot": "packages",
    },
    f"{HANDBOOK}/containers.md": {
        "Server": "images",
        "Robot": "images",
    },
}


def read(page):
    return (ROOT / page).read_text(encoding="utf-8")


def user_pages():
    """README.md first."""
    return ["README.md", *sorted(str(path.relative_to(ROOT))
                                 for path in (ROOT / HANDBOOK).glob("*.md"))]


def without_fences(text):
    """The text with as many lines, those of fenced blocks empty."""
    lines, inside = [], False
    for line in text.splitlines():
        fence = line.lstrip().startswith("```")
        lines.append("" if fence or inside else line)
        inside ^= fence
    return "\n".join(lines) + "\n"


def without_comment(command):
    return re.sub(r"(?<=\s)#.*", "", command).strip()


def commands(text):
    """(line, section, command) of each command; before the first `## ` the section is empty."""
    section, start, parts, block = "", 0, [], False
    for number, line in enumerate(without_fences(text).splitlines(), 1):
        if line.startswith("## "):
            section = line[3:].strip()
        if line.startswith("    ") and not line[4:].lstrip().startswith(("- ", "1. ")):
            block = True
        elif line.strip():
            block = False
        if not block or not line.strip():
            continue
        start = start if parts else number
        parts.append(without_comment(line))
        if parts[-1].endswith("\\"):
            parts[-1] = parts[-1][:-1].strip()
            continue
        if parts[-1]:
            yield start, section, " ".join(parts)
        parts = []


def missing_sections(page):
    """Of RUN."""
    text = read(page)
    return [name for name in RUN[page] if not re.search(rf"^## {re.escape(name)}$", text, re.M)]


def commands_that(test, page):
    """The commands of `page` that the ctest `test` runs, in their order."""
    missing = missing_sections(page)
    if missing:
        raise LookupError(f"{page} has no section {missing[0]}")
    return [command for _, section, command in commands(read(page))
            if RUN[page].get(section) == test]
