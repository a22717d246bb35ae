"""Attacks on the policy server's port, as scenarios against real processes.

    redteam_test.py                     names of the scenarios that tests/run runs
    redteam_test.py --all               names of all of them
    redteam_test.py --table             compares the table in README.md with them
    redteam_test.py BINARIES SCENARIO   runs one, for RIPS_ATTACK_S seconds (6)

Each runs beside a robot under guard, which must not notice: its lease lives, nothing is lost, an
operator is served and a new agent admitted within 2 s during and after, the server's memory stays under 1 GiB, and an alert
names the attacker where there is one to name. The attacker has an address of its own, and at most a
viewer's certificate.
"""

import pathlib
import shutil
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
import connection_attacks  # noqa: E402,F401
import fairness_attacks  # noqa: E402,F401
import field_attacks  # noqa: E402,F401
import graph_attacks  # noqa: E402,F401
import rival_attacks  # noqa: E402,F401
import stream_attacks  # noqa: E402,F401
from fleet import SOURCE, perform  # noqa: E402
from guarded import (ADMITTED_S, DISK_MIB, MEMORY_MIB, QUICK, SCENARIOS,  # noqa: E402
                     VERDICT_P99_S, Guarded)


def check_table():
    """Problems: an attack without a row of what it did in 60 s, or with one beyond the bounds."""
    text = (SOURCE / "tests/redteam/README.md").read_text(encoding="utf-8")
    table = text.partition("\n| attack |")[2].partition("\n\n")[0].splitlines()[2:]
    rows = {cells[1].strip(" `"): [cell.strip() for cell in cells[2:-1]]
            for cells in (line.split("|") for line in table)}
    problems = [f"no row for {name}" for name in SCENARIOS if name not in rows]
    problems += [f"a row for {name}, which is no attack here" for name in rows
                 if name not in SCENARIOS]
    bounds = (VERDICT_P99_S * 1_000, ADMITTED_S * 1_000, MEMORY_MIB, DISK_MIB)
    for name, cells in rows.items():
        measured = cells[1], *cells[3:6]  # p99 and a new agent's wait in ms, memory and disk in MiB
        problems += [f"{name}: {value} is not below {bound}" for value, bound
                     in zip(measured, bounds) if value != "-" and float(value) >= bound]
    return problems


def main():
    if sys.argv[1:] == ["--table"]:
        problems = check_table()
        print("\n".join(problems) or f"{len(SCENARIOS)} attacks, each with its row")
        return 1 if problems else 0
    if sys.argv[1:] in ([], ["--all"]):
        print("\n".join(SCENARIOS if sys.argv[1:] else QUICK))
        return 0
    if len(sys.argv) != 3 or sys.argv[2] not in SCENARIOS:
        print(__doc__, file=sys.stderr)
        return 2
    name = sys.argv[2]
    directory = tempfile.mkdtemp(prefix=f"{name}.")
    code = perform(name, SCENARIOS[name], Guarded(sys.argv[1], directory), tail=15)
    shutil.rmtree(directory, ignore_errors=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
