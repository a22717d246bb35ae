"""A manual page (roff) of a program, from what its --help prints and a line of SENTENCES."""

import re

# What `apropos` shows; and what is to be said of a program that has no --help.
SENTENCES = {
    "rips-policy-server": ("evaluate rules and keep the alert levels of a fleet of robots", ""),
    "rips-sensor": ("report what happens on a DDS domain to the RIPS policy server", ""),
    "rips-wire": ("report the DDS traffic that discovery does not show", ""),
    "rips-actuator": ("apply alert levels to a ROS 2 robot", ""),
    "rips-exec": ("run the programs of alert levels for rips-actuator", ""),
    "rips-fw": ("change the packet filter for rips-actuator", ""),
    "rips-alarm": ("list, read and set the USB alarms of a robot", ""),
    "rips-inspect": (
        "confine a plugin that looks at message payloads",
        "Started by rips-policy-server and ripsctl with a specification of what the plugin may do; "
        "it refuses to be started by hand."),
    "rips-scan": (
        "look for YARA rules in message payloads",
        "Started by rips-policy-server and ripsctl in a confinement of its own; it refuses to be "
        "started by hand."),
    "rips-enrol": ("fetch the certificates of a robot's RIPS agents, and renew them", ""),
    "rips-mint": ("make the certificates of a small fleet of RIPS daemons and operators", ""),
}
USER_COMMANDS = ("rips-mint",)  # section 1; the others are daemons and their helpers, section 8


def section(program):
    return 1 if program in USER_COMMANDS else 8


def escape(text):
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return "\\&" + text if text.startswith((".", "'")) else text


def options(lines):
    """Headings, paragraphs, and `  --flag VALUE   text`, where the text may be in the next line."""
    paragraph = False
    for line in lines:
        flag = re.match(r" {2}(\S(?:\S| (?! ))*)(?: {2,}(.*))?$", line)
        heading = re.match(r"([A-Za-z]+):?$", line)
        if flag:
            yield from (".TP", f"\\fB{escape(flag[1])}\\fR")
            if flag[2]:
                yield escape(flag[2])
        elif heading:
            yield f".SH {heading[1].upper()}"
        elif line.strip():
            if not paragraph and not line.startswith(" "):
                yield ".PP"
            yield escape(line.strip())
        paragraph = bool(line.strip()) and not line.startswith(" ") and not heading


def manual_page(program, version, help_text):
    """`help_text` is None for a program without --help."""
    sentence, description = SENTENCES[program]
    page = [f'.TH {program.upper()} {section(program)} "" "rips {version}"', ".nh", ".ad l",
            ".SH NAME", f"{escape(program)} \\- {escape(sentence)}"]
    lines = (help_text or "").splitlines()
    usage = next((line for line in lines if line.lower().startswith("usage: ")), None)
    if usage:
        page += [".SH SYNOPSIS", escape(usage[len("usage: "):])]
        lines.remove(usage)
    page.append(".SH DESCRIPTION")
    if not lines or not lines[0]:  # no sentence of its own
        page.append(escape(description or sentence[0].upper() + sentence[1:] + "."))
    page += options(lines)
    files = sorted(set(re.findall(r"=(/\S+)", help_text or "")))
    if files:
        page.append(".SH FILES")
        for file in files:
            page += [".TP", f"\\fI{escape(file)}\\fR", "The default; see above."]
    see = "ripsctl(1)" if program != "rips-inspect" else "rips-policy-server(8), ripsctl(1)"
    return "\n".join(page + [".SH SEE ALSO", escape(see), ""])
