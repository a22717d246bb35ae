#!/usr/bin/env python3
"""What a sensor adds to the traffic of discovery, packets and bytes on loopback.

    unshare --net tests/bench/discovery_traffic.py BINARIES [PARTICIPANTS] [SECONDS]

Processes with five topics each stand still, first alone, then with a sensor beside them that does not
announce itself as a node, and then with one that does. Run it in a network of its own, since it
counts every packet there is.
"""

import os
import pathlib
import subprocess
import sys
import tempfile
import time

SOURCE = pathlib.Path(__file__).resolve().parents[2]
URI = ("<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" multicast=\"true\"/>"
       "</Interfaces></General><Discovery><ParticipantIndex>none</ParticipantIndex></Discovery>"
       "</Domain></CycloneDDS>")
DOMAIN = "23"


def loopback():
    """Packets and bytes received on lo since the start."""
    for line in pathlib.Path("/proc/net/dev").read_text().splitlines():
        name, _, fields = line.partition(":")
        if name.strip() == "lo":
            numbers = fields.split()
            return int(numbers[1]), int(numbers[0])
    raise SystemExit("no loopback interface")


def measured(seconds):
    before = loopback()
    time.sleep(seconds)
    return [b - a for a, b in zip(before, loopback())]


def sensor_config(directory, announce):
    pki = directory / "pki"
    if not pki.exists():
        for args in (["init"], ["sensor", "r1", "base"]):
            subprocess.run([SOURCE / "deploy/pki/mint", "--dir", pki, "--trust-domain",
                            "fleet.example", *args], check=True, stdout=subprocess.DEVNULL)
    files = pki / "sensor/r1/base"
    config = directory / f"sensor-{announce}.yaml"
    config.write_text(f"""robot: r1
host: base
servers: ["127.0.0.1:1"]
tls: {{ca: {files}/ca.pem, cert: {files}/cert.pem, key: {files}/key.pem}}
dds: {{domain: {DOMAIN}, interface: lo, announce: {announce}}}
metrics: ""
state_dir: {directory}
""")
    return config


def main():
    binaries = pathlib.Path(sys.argv[1]).resolve()
    participants = int(sys.argv[2]) if len(sys.argv) > 2 else 10
    seconds = float(sys.argv[3]) if len(sys.argv) > 3 else 30
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    os.environ["CYCLONEDDS_URI"] = URI
    processes = []
    with tempfile.TemporaryDirectory() as name:
        rows = []
        try:
            for i in range(participants):
                topics = [f"rt/p{i}/t{j},std_msgs::msg::dds_::String_,reliable" for j in range(5)]
                # It waits for readers that never come.
                processes.append(subprocess.Popen(
                    [binaries / "dds_peer", "--domain", DOMAIN, "--node", f"/n{i}", "--readers",
                     "1000", *(word for topic in topics for word in ("--publish", topic))],
                    stdout=subprocess.DEVNULL))
            time.sleep(15)
            rows.append(("alone", measured(seconds), seconds))
            for announce in ("false", "true"):
                config = sensor_config(pathlib.Path(name), announce)
                sensor = subprocess.Popen([binaries / "rips-sensor", "--config", config],
                                          stderr=subprocess.DEVNULL)
                processes.append(sensor)
                what = f"announce: {announce}"
                rows.append((f"{what}, first 5 s", measured(5), 5))
                rows.append((what, measured(seconds), seconds))
                sensor.terminate()
                sensor.wait()
                time.sleep(5)
        finally:
            for process in processes:
                process.kill()
                process.wait()
    print(f"{participants} participants with 5 topics each, {seconds:g} s")
    for what, (packets, size), duration in rows:
        print(f"{what:28} {packets / duration:8.1f} packets/s {size / duration:10.0f} bytes/s")


if __name__ == "__main__":
    main()
