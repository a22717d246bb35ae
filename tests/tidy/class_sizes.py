"""How many members and methods a C++ class has.

Counted is what a reader must hold in mind: variables and functions, overrides too. Not counted are
types, constants, friends, and functions that are deleted or defaulted.
"""

import re

NOISE = re.compile(r'//[^\n]*|/\*.*?\*/|R"\((?:.|\n)*?\)"|"(?:\\.|[^"\\\n])*"|'
                   r"'(?:\\.|[^'\\\n])'|^[ \t]*#(?:[^\n\\]|\\.|\\\n)*", re.S | re.M)
HEAD = re.compile(r"(?<!enum )\b(?:class|struct)\s+(?:\[\[\w+\]\]\s*)?(?:ABSL_\w+(?:\([^)]*\))?\s+)?"
                  r"(\w+(?:::\w+)*)\s*(?:final\s*)?(?::[^:;{(][^;{(]*)?\{")
LABEL = re.compile(r"^\s*(?:public|private|protected)\s*:")
UNCOUNTED = re.compile(r"^(?:using|typedef|friend|static_assert|enum|static constexpr|"
                       r"static inline constexpr|(?:class|struct|union)\b[^()]*$|template\s*<[^;]*friend)|"
                       r"=\s*(?:delete|default)$")


def _end(text, at):
    """Behind the brace that closes the one at `at`."""
    depth = 0
    for i in range(at, len(text)):
        depth += {"{": 1, "}": -1}.get(text[i], 0)
        if depth == 0:
            return i + 1
    return len(text)


def _statements(body):
    """Those of a class's body, without the bodies of functions."""
    held, i = "", 0
    while i < len(body):
        held = LABEL.sub("", held)
        if body[i] == ";":
            yield held.strip()
            held, i = "", i + 1
        elif body[i] == "{":
            i = _end(body, i)
            rest = body[i:].lstrip()[:1]
            # Of a function, unless it initializes a member before its body.
            if "(" in held and rest not in (";", ",", "{"):
                yield held.strip()
                held = ""
        else:
            held += body[i]
            i += 1


def class_sizes(text):
    """(name, line, count) of each class and struct in `text`."""
    blank = NOISE.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    for head in HEAD.finditer(blank):
        body = blank[head.end():_end(blank, head.end() - 1) - 1]
        count = sum(1 for statement in _statements(body)
                    if statement and not UNCOUNTED.search(" ".join(statement.split())))
        yield head[1], blank.count("\n", 0, head.start()) + 1, count
