"""No key, payload or rule text leaves a daemon unasked: not in logs, not in metrics, not in a core.

    secrets_test.py BINARIES SCENARIO      runs one; without SCENARIO prints their names
"""

import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import fleet_test  # noqa: E402
from fleet import page  # noqa: E402
from fleet_test import check  # noqa: E402

DAEMONS = ["policy-server", "sensor", "actuator", "exec"]
# What a payload of `robot_sim publish` consists of, and what no log line does.
PAYLOAD = "x" * 48
# In every place of a policy in which text may stand; some draw warnings.
RULES = """levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
consts: hidden set string = {"planted_set"};
vars: told bool = false;
rules Msg:
  seen:
    topicin("/load") && payload("yara/planted.yar") && !told ?
      set(told, true) => alert("planted_alert", "high") => exec("leak", "planted_argument");
  fails: topicmatches("^/planted_regex$") || topicin("planted_relative") ? alert("planted_text");
  words: Sender == "planted_word" || topicin(hidden) ? exec("leak", "planted_" + Topic);
rules External:
  line: idsalert("planted_ids") ? trigger(ALERT);
  calm: CurrLevel == ALERT && "planted_constant" == "planted_constant" ? trigger(DEFAULT);
  unused: false ? trigger(COMPROMISED), trigger(HALT);
"""
YARA = """rule planted_yara { strings: $a = "%s" $b = "planted_pattern" condition: any of them }
""" % PAYLOAD
# A mistake in a line that holds a text, and one whose message would name it.
BROKEN = """rules External:
  wrong: signal("planted_signal") ? alert("planted_mistake" + 7);
"""


def body_of_keys(directory):
    """Pieces of every private key below `directory`, long enough to be nothing else."""
    pieces = set()
    for path in directory.rglob("key.pem"):
        text = "".join(line for line in path.read_text().splitlines() if not line.startswith("-"))
        pieces |= {text[at:at + 16] for at in range(0, len(text) - 16, 4)}
    check(len(pieces) > 20, f"no keys in {directory}")
    return pieces


def planted_in(text, keys):
    """What of the planted is in `text`."""
    found = {word for word in text.replace('"', " ").split() if "planted_" in word}
    found |= {needle for needle in keys if needle in text}
    return found | ({"a payload"} if PAYLOAD in text else set())


def page_of(process):
    """All that a daemon serves by HTTP."""
    return "".join(page(process, path) for path in ("metrics", "readyz", "healthz"))


def loudly(fleet):
    """Daemons of the fleet log all they can."""
    start = fleet.start

    def start_loudly(name, *args):
        return start(name, *args, *(["--log-level", "debug"] if name in DAEMONS else []))
    fleet.start = start_loudly


def write_bundle(fleet):
    fleet.bundle = "hidden"
    fleet.write("bundles/hidden/manifest.yaml",
                "name: hidden\nrules: [a.rul]\nyara: [yara/planted.yar]\n"
                "levels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
    fleet.write("bundles/hidden/yara/planted.yar", YARA)
    return fleet.write("bundles/hidden/a.rul", RULES)


def allow_program(fleet):
    """A program that writes what nobody may see, and fails."""
    programs = pathlib.Path(tempfile.mkdtemp(prefix="rips-test-", dir="/opt"))
    fleet.leftovers.append(programs)
    path = programs / "leak"
    path.write_text("#!/bin/sh\necho planted_output; echo planted_error >&2; exit 3\n")
    path.chmod(0o755)
    fleet.programs = f"programs:\n  - {{name: leak, path: {path}, timeout: 5s}}\n"


def logs_and_metrics_hold_none(fleet):
    """Rules that draw warnings and errors, payloads that are inspected, a program that talks, IDS lines
    that make no sense: the alert is there, and no log or page holds what was planted."""
    rules = write_bundle(fleet)
    if os.geteuid() == 0:  # programs of an allow-list must belong to root
        allow_program(fleet)
    ids = fleet.dir / "eve.json"
    ids.write_text("")
    fleet.sensor_options = f"ids: [{{format: eve, path: {ids}}}]\n"
    loudly(fleet)
    fleet.arm()
    server = fleet.server
    server.wait_for(lambda line: "rule compiler warnings" in line and "RelativeTopic" in line, 5,
                    "the warnings are logged")

    fleet.start_publisher("--bytes", "300", "--rate", "20")
    deadline = time.monotonic() + 20
    while not any(alert["text"] == "planted_alert" for alert in fleet.alerts()):
        check(time.monotonic() < deadline, "the payload was not found")
        time.sleep(0.1)
    with ids.open("a") as log:
        log.write('{"event_type":"alert","planted_field":"planted_value","alert":{}}\nplanted_line\n')
    fleet.sensor.wait_for(lambda line: "cannot parse a line of an IDS log" in line, 10, "the line is reported")
    if fleet.exec is not None:
        fleet.exec.wait_for(lambda line: "program=leak" in line and " ended " in line, 10,
                            "the program has run")
    rules.write_text(RULES + BROKEN)
    server.child.send_signal(signal.SIGHUP)
    server.wait_for(lambda line: "bundle refused" in line and "TypeMismatch" in line, 10,
                    "the refusal is logged")
    fleet.ripsctl("level", "raise", "r1", "--to", "HALT", "--reason", "a test")
    fleet.wait_level("HALT", 20)

    pages = {each.name: page_of(each) for each in (server, fleet.sensor, fleet.actuator)}
    keys = body_of_keys(fleet.dir / "pki")
    logs = {name: (fleet.dir / f"{name}.log").read_text() for name in DAEMONS
            if (fleet.dir / f"{name}.log").exists()}
    check(len(logs) >= 3 and all(len(text) > 200 for text in logs.values()), "there are no logs")
    for where, texts in (("log", logs), ("pages", pages)):
        for name, text in texts.items():
            found = planted_in(text, keys)
            check(not found, f"{where} of {name}: {sorted(found)}")
    # The author's own terminal shows the rule.
    _, shown, _ = fleet.ripsctl("rules", "check", str(rules), check=False)
    check("planted_mistake" in shown and "planted_relative" in shown, f"check shows {shown}")


def run_wrong(fleet, daemon, config):
    """What a daemon says that is given a wrong configuration."""
    child = subprocess.Popen([fleet.bin / f"rips-{daemon}", "--config", config, "--log-level", "debug"],
                             stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                             stderr=subprocess.STDOUT, text=True, env=fleet.env)
    try:
        said, _ = child.communicate(timeout=4)
        check(child.returncode != 0, f"rips-{daemon} takes {config}")
    except subprocess.TimeoutExpired:  # it waits for files that can be used
        child.kill()
        said, _ = child.communicate()
    return said


def mistaken_configurations_show_no_key(fleet):
    """A key where configuration, a certificate or the path of a key belongs."""
    fleet.prepare()
    fleet.start_server()
    fleet.write_agent_configs()
    keys = body_of_keys(fleet.dir / "pki")
    said = {}
    for daemon, who in (("policy-server", "server/ps1"), ("sensor", "sensor/r1/base"),
                        ("actuator", "actuator/r1/base")):
        own = fleet.dir / "pki" / who
        good = (fleet.dir / f"{daemon}.yaml").read_text()
        pem = (own / "key.pem").read_text()
        inline = pem.replace("\n", "\\n")
        said[f"{daemon}: the key is the configuration"] = run_wrong(fleet, daemon, own / "key.pem")
        for what, text in (
                ("the key for its path", good.replace(f"key: {own}/key.pem", f'key: "{inline}"')),
                ("the key behind a mistake", good + "nonsense: |\n  " + pem.replace("\n", "\n  ")),
                ("the key for the certificate", good.replace(f"{own}/cert.pem", f"{own}/key.pem")),
                ("the key for the authority", good.replace(f"{own}/ca.pem", f"{own}/key.pem")),
                ("the certificate for the key", good.replace(f"{own}/key.pem", f"{own}/cert.pem"))):
            check(text != good, f"{daemon}.yaml is otherwise than expected")
            said[f"{daemon}: {what}"] = run_wrong(fleet, daemon,
                                                  fleet.write(f"wrong-{daemon}.yaml", text))
    for what, text in said.items():
        check(text.strip(), f"{what}: nothing is said")
        found = planted_in(text, keys)
        check(not found, f"{what}: {text}")


def readable(pid):
    """Whether another process of the same user may attach to `pid`, as ptrace(2) judges it: it may
    not if `pid` is not dumpable. The link of its program is kept from those who may not."""
    reader = subprocess.run([*WITHOUT_PTRACE, "readlink", f"/proc/{pid}/exe"], capture_output=True)
    return reader.returncode == 0


# Root may read everything, by one capability; so neither the daemons nor the reader have it.
WITHOUT_PTRACE = (["setpriv", "--bounding-set=-sys_ptrace", "--inh-caps=-sys_ptrace"]
                  if os.geteuid() == 0 else [])


def nothing_is_left_in_a_core(fleet):
    """Every daemon has a core limit of 0 and is not dumpable, so that its memory is not readable for
    other processes of its user either."""
    fleet.within = WITHOUT_PTRACE
    if os.geteuid() == 0:
        allow_program(fleet)
    fleet.arm()
    daemons = [fleet.server, fleet.sensor, fleet.actuator]
    daemons.append(fleet.start_exec())
    if os.geteuid() == 0:
        path = fleet.dir / "actuator.yaml"
        path.write_text(path.read_text() + f'firewall: {{socket: {fleet.dir}/fw.sock, user: "0"}}\n')
        daemons.append(fleet.start("fw", fleet.bin / "rips-fw", "--config", path))
        daemons[-1].wait_for(lambda line: "listening" in line, 10, "rips-fw listens")
        wire_ready = fleet.dir / "wire.ready"
        daemons.append(fleet.start("wire", fleet.bin / "rips-wire", "--domain", fleet.domain,
                                   "--interface", "lo", "--socket", fleet.dir / "wire.sock",
                                   "--ready-file", wire_ready))
        fleet._ready(daemons[-1], wire_ready, "rips-wire")
    other = fleet.start("other", "sleep", "60")
    time.sleep(0.2)  # until it is what it executes
    check(readable(other.child.pid), "this test could not read what may be read")
    for daemon in daemons:
        pid = daemon.child.pid
        limits = pathlib.Path(f"/proc/{pid}/limits").read_text().splitlines()
        core = next(line for line in limits if line.startswith("Max core file size"))
        check(core.split()[4:6] == ["0", "0"], f"{daemon.name}: {core}")
        check(not readable(pid), f"{daemon.name} is dumpable")


fleet_test.SCENARIOS = [logs_and_metrics_hold_none, mistaken_configurations_show_no_key,
                        nothing_is_left_in_a_core]


if __name__ == "__main__":
    sys.exit(fleet_test.main())
