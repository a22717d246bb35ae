"""Attacks on what operators are told of a level, by peers on the bus that hold no key.

    level_attacks_test.py                     names of the scenarios
    level_attacks_test.py BINARIES SCENARIO   runs one; RIPS_ROUNDS says how many times it attacks
"""

import os
import pathlib
import sys
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from fleet import SOURCE, Fleet, check, eventually, play  # noqa: E402

ROUNDS = int(os.environ.get("RIPS_ROUNDS", "2"))
# From `verified`: the second that nothing is said of what was under way, and that the parts of a
# message's way may take.
CONTRADICTED_S = 2


class Levels(Fleet):
    """A robot whose parts can be told to go on although they answer that they are inactive."""

    def arm_controlled(self):
        self.pipe = self.dir / "robot.control"
        self.arm("--control", self.pipe)

    def goes_on(self, node, on):
        with open(self.pipe, "w", encoding="ascii") as pipe:
            pipe.write(f"goes_on {node} {'on' if on else 'off'}\n")

    def order(self, verb, level, *options):
        self.ripsctl("level", verb, "r1", "--to", level, "--reason", "red team", *options)

    def stage(self):
        status = self.level()
        return status["decided_level"], status["stage"]


def a_part_goes_on_under_a_forged_answer(fleet):
    """Whoever answers for a part that it is inactive makes the level verified; the part's messages
    contradict it."""
    fleet.arm_controlled()
    slowest = 0
    for attempt in range(ROUNDS):
        fleet.goes_on("/navigator", True)
        fleet.order("raise", "COMPROMISED")
        fleet.wait_level("COMPROMISED", 10)
        verified = time.monotonic()
        eventually(lambda: fleet.stage() == ("COMPROMISED", "contradicted"), 10,
                   "the level is contradicted", every=0.02)
        slowest = max(slowest, time.monotonic() - verified)
        told = [a for a in fleet.alerts() if "is contradicted: node /navigator publishes /cmd_vel"
                in a["text"] and a["severity"] == "critical"]
        check(len(told) == attempt + 1, f"{len(told)} alerts in round {attempt}")
        seen = fleet.query("level", "show", "r1")
        check(any("level COMPROMISED is contradicted" in text
                  for text in seen["status"]["degraded"]), f"{seen}")
        code, _, error = fleet.ripsctl("level", "lower", "r1", "--to", "DEFAULT", "--reason", "x",
                                       check=False)
        check(code == 1 and "is contradicted" in error, f"it was lowered: {error}")
        fleet.goes_on("/navigator", False)
        fleet.order("lower", "DEFAULT", "--accept-blind")
        fleet.wait_level("DEFAULT", 10)
    print(f"contradicted {slowest:.2f} s after verified at most, {ROUNDS} of {ROUNDS}")
    check(slowest < CONTRADICTED_S, f"{slowest:.2f} s")

    # Parts that do as they say.
    fleet.order("raise", "HALT")
    fleet.wait_level("HALT", 10)
    time.sleep(2.5)
    check(fleet.stage() == ("HALT", "verified"), f"an honest robot: {fleet.level()}")


def visitors_do_not_hold_a_robot(fleet):
    """A participant without node and topic, which comes and goes all the time, does not keep two
    operators from releasing a robot; one that publishes what rules name does."""
    fleet.bundle = "two"
    fleet.write("bundles/two/warehouse.rul", (SOURCE / "rules/warehouse/warehouse.rul").read_text())
    fleet.write("bundles/two/manifest.yaml",
                "name: two\nrules: [warehouse.rul]\nlevels: [DEFAULT, ALERT, COMPROMISED, HALT]\n"
                "two_person: [COMPROMISED, HALT]\n")
    fleet.arm()
    fleet.mint("operator", "operator", "bob")
    stop = threading.Event()
    visits = []

    def visit():
        while not stop.is_set():
            peer = fleet.start("visitor", fleet.bin / "dds_peer", "--domain", fleet.domain,
                               "--interface", fleet.interface)
            peer.wait_for(lambda line: line.startswith("up "), 10, "the visitor comes")
            stop.wait(0.5)
            peer.kill()
            visits.append(peer)
            stop.wait(0.3)

    def ask():
        answer = fleet.query("level", "lower", "r1", "--to", "ALERT", "--reason", "clear",
                             check=False)
        return answer["pending_approval_id"]

    def approve(lowering, *options):
        return fleet.ripsctl("level", "approve", "r1", lowering, "--reason", "seen, too", *options,
                             check=False, who="operator/bob")

    visitor = threading.Thread(target=visit, daemon=True)
    visitor.start()
    try:
        for attempt in range(ROUNDS):
            fleet.order("raise", "COMPROMISED")
            fleet.wait_level("COMPROMISED", 10)
            lowering = ask()
            before = len(visits)
            eventually(lambda: len(visits) >= before + 3, 20, "visitors come and go")
            code, out, error = approve(lowering)
            check(code == 0, f"round {attempt}: {out}{error}")
            fleet.wait_level("ALERT", 10)
    finally:
        stop.set()
        visitor.join()

    fleet.order("raise", "COMPROMISED")
    fleet.wait_level("COMPROMISED", 10)
    lowering = ask()
    named = fleet.start("named", *fleet.robot_sim("publish"), "--topic", "/chatter", "--readers",
                        "0", "--count", "1")
    eventually(lambda: "/load came" in fleet.ripsctl("level", "show", "r1")[1], 10,
               "what has changed is shown")
    code, _, error = approve(lowering)
    check(code == 1 and "node /load came" in error and "--accept-changes" in error, error)
    code, _, error = approve(lowering, "--accept-changes")
    check(code == 0, error)
    check("accepted: node /load came" in fleet.history()[-1]["reason"], f"{fleet.history()[-1]}")
    fleet.wait_level("ALERT", 10)
    named.kill()

    fleet.order("raise", "HALT")
    fleet.wait_level("HALT", 10)
    lowering = ask()
    driver = fleet.start_intruder("rogue-cmd-vel")
    eventually(lambda: any("cannot be approved any more" in a["text"] for a in fleet.alerts()), 10,
               "a second driver ends it")
    code, _, error = approve(lowering, "--accept-changes")
    check(code == 1 and "no lowering of r1 waits" in error, error)
    driver.kill()


if __name__ == "__main__":
    sys.exit(play([a_part_goes_on_under_a_forged_answer, visitors_do_not_hold_a_robot], Levels))
