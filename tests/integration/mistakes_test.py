"""The mistakes that administrators make most often: each is named, with its file and what to do,
where a person looks: in the log of the daemon that has it, and of the server that meets it.
"""

import os
import pathlib
import shutil
import subprocess
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
sys.dont_write_bytecode = True
from fleet import SOURCE, Fleet, Skipped, check, play  # noqa: E402

OTHER_USER = 65534


def begin(fleet):
    fleet.prepare()
    fleet.server = fleet.start_server()


def start_sensor(fleet, change=lambda text: text):
    """The sensor with its configuration changed; not waited for."""
    write = fleet.write_agent_configs

    def write_changed():
        write()
        config = fleet.dir / "sensor.yaml"
        config.write_text(change(config.read_text()))
    fleet.write_agent_configs = write_changed
    fleet.sensor = fleet.start_agent("sensor", wait=False)
    fleet.write_agent_configs = write
    return fleet.sensor


def says(process, *parts, seconds=20):
    """Waits for one line that has all of these parts."""
    process.wait_for(lambda line: all(part in line for part in parts), seconds,
                     f"{process.name} says {parts}")


def files_of(fleet):
    return fleet.dir / "pki/sensor/r1/base"


def foreign_files(fleet):
    """Files of a sensor of the same name, by another authority."""
    mint = [SOURCE / "deploy/pki/mint", "--dir", fleet.dir / "other", "--trust-domain",
            "fleet.example"]
    for what in (["init"], ["sensor", "r1", "base"]):
        subprocess.run([*mint, *what], check=True, stdout=subprocess.DEVNULL)
    return fleet.dir / "other/sensor/r1/base"


def wrong_authority(fleet):
    """All files are of another authority: the sensor does not trust the server."""
    begin(fleet)
    for name in ("ca.pem", "cert.pem", "key.pem"):
        shutil.copy(foreign_files(fleet) / name, files_of(fleet) / name)
    says(start_sensor(fleet), f"127.0.0.1:{fleet.port}` is not issued under",
         f"{files_of(fleet)}/ca.pem", "openssl s_client")
    says(fleet.server, "connection ended before its peer was known", "it does not take ours")


def wrong_certificate(fleet):
    """The sensor trusts the server, and has its certificate of another authority."""
    begin(fleet)
    for name in ("cert.pem", "key.pem"):
        shutil.copy(foreign_files(fleet) / name, files_of(fleet) / name)
    sensor = start_sensor(fleet)
    says(sensor, "waiting for a usable certificate", f"{files_of(fleet)}/cert.pem",
         "not valid under `ca`")
    both = (files_of(fleet) / "ca.pem").read_text() + (foreign_files(fleet) / "ca.pem").read_text()
    (files_of(fleet) / "ca.pem").write_text(both)
    says(sensor, f"127.0.0.1:{fleet.port}` ended the connection",
         f"the issuer of `{files_of(fleet)}/cert.pem`", "its log says which")
    says(fleet.server, "connection ended before its peer was known", "not issued under our `tls.ca`")


def wrong_robot(fleet):
    begin(fleet)
    fleet.mint("sensor", "r2", "base")
    for name in ("cert.pem", "key.pem"):
        shutil.copy(fleet.dir / "pki/sensor/r2/base" / name, files_of(fleet) / name)
    sensor = start_sensor(fleet)
    says(sensor, f"{files_of(fleet)}/cert.pem", "/robot/r2/sensor/base",
         "the configuration says robot `r1`", "use the certificate of this sensor")
    check(sensor.child.wait(10) == 2, "systemd would start it again")


def robot_that_is_not_listed(fleet):
    begin(fleet)
    fleet.mint("sensor", "r2", "base")
    sensor = start_sensor(fleet, lambda text: text.replace("robot: r1", "robot: r2")
                          .replace("/sensor/r1/", "/sensor/r2/"))
    says(sensor, "robot `r2` is not in the inventory")
    says(fleet.server, "sensor stream refused", "robot `r2` is not in the inventory")


def unreachable_server(fleet):
    fleet.prepare()
    fleet.port = 1  # nothing listens there
    says(start_sensor(fleet), "no stream to the policy server", "127.0.0.1:1", "Connection refused")


def not_a_tls_server(fleet):
    begin(fleet)
    _, line = fleet.server.wait_for(lambda text: " metrics=" in text and text, 10, "its metrics")
    fleet.port = int(line.rpartition(":")[2])
    says(start_sensor(fleet), f"`127.0.0.1:{fleet.port}`", "TLS", "is the port right?")


def two_robots_with_one_key(fleet):
    begin(fleet)
    fleet.start_agent("sensor")
    (fleet.dir / "copy").mkdir()
    copy = start_sensor(fleet, lambda text: text.replace(f"state_dir: {fleet.dir}/sensor",
                                                         f"state_dir: {fleet.dir}/copy"))
    says(copy, "no stream to the policy server", "sensor r1/base has a live session")
    says(fleet.server, "sensor refused", "sensor r1/base has a live session", "peer=ipv4:127.0.0.1")
    deadline = time.monotonic() + 20
    while "a second process uses the key of sensor base" not in fleet.ripsctl("robot", "list")[1]:
        check(time.monotonic() < deadline, "`robot list` does not show it")
        time.sleep(0.2)


def missing_key(fleet):
    begin(fleet)
    key = files_of(fleet) / "key.pem"
    kept = key.read_bytes()
    key.unlink()
    sensor = start_sensor(fleet)
    says(sensor, "waiting for a usable certificate", f"`{key}`", "No such file")
    key.touch(0o600)
    key.write_bytes(kept)
    says(sensor, " streaming ")


def open_key(fleet):
    """No daemon starts with a key that others may read."""
    fleet.prepare()
    fleet.port = 1
    fleet.write_agent_configs()
    for name, mine in (("sensor", "sensor/r1/base"), ("actuator", "actuator/r1/base"),
                       ("policy-server", "server/ps1")):
        key = fleet.dir / "pki" / mine / "key.pem"
        key.chmod(0o604)
        done = subprocess.run([fleet.bin / f"rips-{name}", "--config", fleet.dir / f"{name}.yaml"],
                              capture_output=True, text=True, env=fleet.env, timeout=60)
        check(done.returncode == 2 and f"`{key}` is open to other users (mode 0604)" in done.stderr,
              f"rips-{name}: {done.returncode}: {done.stderr}")


def unreadable_key(fleet):
    if os.geteuid() != 0:
        raise Skipped("only root can become another user")
    closed = [path for path in fleet.dir.parents if not path.stat().st_mode & 0o001]
    if closed:
        raise Skipped(f"other users cannot enter {closed[0]}")
    begin(fleet)
    shutil.chown(fleet.dir / "sensor", OTHER_USER, OTHER_USER)
    for path in [fleet.dir / "pki", *(fleet.dir / "pki").rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
    (files_of(fleet) / "key.pem").chmod(0o600)
    fleet.within = ["setpriv", f"--reuid={OTHER_USER}", "--clear-groups"]
    says(start_sensor(fleet), "waiting for a usable certificate", f"`{files_of(fleet)}/key.pem`",
         "Permission denied")


def wrong_interface(fleet):
    begin(fleet)
    fleet.env["CYCLONEDDS_URI"] = ""
    sensor = start_sensor(fleet, lambda text: text.replace("interface: lo", "interface: eth9"))
    says(sensor, "no network interface `eth9` here, only", "lo", "`dds.interface`")
    deadline = time.monotonic() + 10
    while "no network interface `eth9` here" not in fleet.ripsctl("robot", "list")[1]:
        check(time.monotonic() < deadline, "`robot list` does not show it")
        time.sleep(0.2)
    check(sensor.running, "it does not wait for the interface")


def wrong_domain(fleet):
    begin(fleet)
    fleet.start_robot()
    fleet.domain += 1
    fleet.start_agent("sensor")
    wanted = (f"sensor base sees no ROS node on domain {fleet.domain}; "
              "are dds.domain and dds.interface right?")
    deadline = time.monotonic() + 30
    while wanted not in fleet.ripsctl("robot", "list")[1]:
        check(time.monotonic() < deadline, "`robot list` does not show it")
        time.sleep(0.2)


def broken_bundle(fleet):
    fleet.bundle = "broken"
    fleet.write("bundles/broken/manifest.yaml",
                "name: broken\nrules: [r.rul]\nlevels: [DEFAULT, ALERT, COMPROMISED, HALT]\n")
    fleet.write("bundles/broken/r.rul",
                "rules Msg:\n  x: topicin(\"/a\") ? trigger(NOWHERE);\n")
    begin(fleet)
    says(fleet.server, "bundle refused", "bundles/broken/r.rul:2:", "ripsctl rules check")
    says(fleet.server, "robot=r1", "nothing judges `r1`", "mend the bundle and send")
    check("no policy: bundle `broken` is refused" in fleet.ripsctl("robot", "list")[1],
          "`robot list` does not show it")


def asked_before_the_start(fleet):
    """--check-config says what the daemon would end for, and warns of what it would wait for."""
    fleet.prepare()
    fleet.port = 1
    fleet.write_agent_configs()
    fleet.env["CYCLONEDDS_URI"] = ""

    def asked(name, code, *parts):
        done = subprocess.run([fleet.bin / f"rips-{name}", "--check-config", "--config",
                               fleet.dir / f"{name}.yaml"], capture_output=True, text=True,
                              env=fleet.env, timeout=60)
        missing = [part for part in parts if part not in done.stderr]
        check(done.returncode == code and not missing,
              f"rips-{name}: {done.returncode}, without {missing}: {done.stderr}")
        return done.stderr

    for name, mine in (("sensor", fleet.dir / "pki/sensor/r1/base"),
                       ("actuator", fleet.dir / "pki/actuator/r1/base"),
                       ("policy-server", fleet.dir / "pki/server/ps1")):
        said = asked(name, 0)
        check("certificate" not in said and "interface" not in said, f"rips-{name} says {said}")
        away = mine.with_name("away")
        mine.rename(away)
        asked(name, 0, "warning: no usable certificate: ", f"`{mine}/", "No such file")
        shutil.copytree(fleet.dir / "pki/operator/operator/alice", mine)
        asked(name, 2, "/operator/", "is ")
        shutil.rmtree(mine)
        away.rename(mine)
        key = mine / "key.pem"
        key.chmod(0o644)
        asked(name, 2, f"`{key}`", "(mode 0644)", f"run `chmod o-rwx {key}`")
        key.chmod(0o640)
        asked(name, 0)
        key.chmod(0o600)
        if name != "policy-server":
            config = fleet.dir / f"{name}.yaml"
            config.write_text(config.read_text().replace("interface: lo", "interface: eth9"))
            asked(name, 0, "warning: there is no network interface `eth9` here, only", "lo")


SCENARIOS = [wrong_authority, wrong_certificate, wrong_robot, robot_that_is_not_listed,
             unreachable_server, not_a_tls_server, two_robots_with_one_key, missing_key, open_key,
             unreadable_key, wrong_interface, wrong_domain, broken_bundle,
             asked_before_the_start]


if __name__ == "__main__":
    sys.exit(play(SCENARIOS, Fleet))
