"""What the benchmarks that run real processes share."""

import pathlib
import re


def resident_kib(pid):
    text = pathlib.Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"^VmRSS:\s+(\d+) kB", text, re.M).group(1))


def print_table(rows):
    """Rows of six cells and whether the budget held; None = there is none."""
    head = ("", "what", "yardstick", "measured", "ratio", "budget", "")
    words = {True: "held", False: "MISSED", None: ""}
    shown = [head] + [(*map(str, row[:6]), words[row[6]]) for row in rows]
    widths = [max(len(row[i]) for row in shown) for i in range(len(head))]
    for row in shown:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip())
