"""Peers that do not read, on streams, on the page of metrics, and at the socket of a helper."""

import functools
import os
import pathlib
import re
import shutil
import socket
import sys
import tempfile
import threading
import time

from fleet import Failed, metrics
from guarded import ATTACK_S, check, quick, resident_kib, scenario
from peer import Peer, pb

# Each picture of the camera comes to the server, and nothing is done about it.
PICTURES = """
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
rules Msg:
  pictures: topicin("/camera/image_raw") && payload("yara/none.yar") ? alert("never");
rules Graph:
  unused: false ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);
"""
NONE = 'rule nothing { strings: $a = "this is in no picture" condition: $a at 0 }\n'
NOBODY = 65534


def watch_pictures(fleet):
    """A camera of 0.9 MB a picture, 15 Hz, whose payloads the rules need."""
    fleet.bundle = "pictures"
    fleet.write("bundles/pictures/manifest.yaml",
                "name: pictures\nrules: [p.rul]\nyara: [yara/none.yar]\n"
                "levels: [DEFAULT, ALERT, COMPROMISED, HALT]\non_inspection_error: ignore\n")
    fleet.write("bundles/pictures/p.rul", PICTURES)
    fleet.write("bundles/pictures/yara/none.yar", NONE)
    fleet.dir.chmod(0o755)
    fleet.start_robot = functools.partial(fleet.start_robot, "--image-width", 640,
                                          "--image-height", 480)
    fleet.arm()
    fleet.mint("operator", "operator", "mallory")


def reason_for(fleet, name):
    return [a["text"] for a in fleet.query("alert", "list", "--limit", "1000")["alerts"]
            if name in a["text"] and "does not read" in a["text"]]


def until(seconds, what, found):
    deadline = time.monotonic() + seconds
    while not found():
        if time.monotonic() > deadline:
            raise Failed(what if isinstance(what, str) else what())
        time.sleep(0.1)


@quick
def recordings_left_unread(fleet):
    """Recordings of a camera by a key that reads none of them, begun anew as they are ended."""
    watch_pictures(fleet)
    before = resident_kib(fleet.server.child.pid)
    pki = fleet.dir / "pki/operator/operator/mallory"
    opened = []

    def attack():
        peer = Peer(fleet.port, pki, reads=False)
        deadline = time.monotonic() + max(ATTACK_S, 15)
        streams = []
        while time.monotonic() < deadline:
            streams = [each for each in streams if each.status is None]
            if len(streams) < 4:  # as many as a robot has
                stream = peer.call("rips.v1.OperatorService", "Record")
                stream.send(pb("RecordRequest")(robot="r1"), last=True)
                streams.append(stream)
                opened.append(stream)
            time.sleep(0.25)
        peer.close()

    fleet.run_beside(attack)
    grown = resident_kib(fleet.server.child.pid) - before
    ended = metrics(fleet.server).get("rips_streams_unread_total", 0)
    print(f"{len(opened)} recordings, {ended:.0f} ended as unread; "
          f"the server grew by {grown >> 10} MiB at most")
    check(ended >= 4, f"only {ended} recordings were ended")
    check(grown < 384 << 10, f"the server grew by {grown >> 10} MiB")
    check(any(each.status for each in opened), "no call was ended although its end is not read")
    check(reason_for(fleet, "operator/operator/mallory"), "no alert names who does not read")
    fleet.unharmed()


@scenario
def watches_left_unread(fleet):
    """States and alerts are not kept for those who do not read: they are told the newest later."""
    fleet.arm()
    peer = Peer(fleet.port, fleet.key(), reads=False)
    for i in range(24):
        if i % 2:
            peer.call("rips.v1.OperatorService", "WatchRobots").send(
                pb("WatchRobotsRequest")(), last=True)
        else:
            peer.call("rips.v1.OperatorService", "WatchAlerts").send(
                pb("WatchAlertsRequest")(after="0"), last=True)
    fleet.run_beside(lambda: time.sleep(ATTACK_S))
    peer.close()
    fleet.unharmed()


def page_address(process):
    _, address = process.wait_for(
        lambda line: re.search(r" listening .*?(?:metrics|address)=(127\.0\.0\.1:\d+)$", line), 15,
        f"{process.name} listens")
    return "127.0.0.1", int(address.group(1).rsplit(":", 1)[1])


def get(address, path, limit):
    """The first line of what a page answers, and how long it took."""
    began = time.monotonic()
    with socket.create_connection(address, timeout=limit) as asking:
        asking.sendall(f"GET {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode())
        answer = b""
        while piece := asking.recv(1 << 16):
            answer += piece
    return answer.split(b"\r\n")[0].decode(), time.monotonic() - began


@quick
def a_page_under_slow_clients(fleet):
    """60 clients that send a byte a second, and 20 that never read, beside a scraper."""
    fleet.arm()
    slowest = 0
    for process in (fleet.server, fleet.sensor, fleet.actuator):
        address = page_address(process)
        stop = threading.Event()

        def drip():
            asking = None
            while not stop.wait(1):
                try:
                    if asking is None:
                        asking = socket.create_connection(address, timeout=5)
                        asking.sendall(b"GET /metrics HTTP/1.1\r\nX-Slow: ")
                    asking.sendall(b"x")
                except OSError:
                    asking = None  # closed: again

        def deaf():
            while not stop.wait(0.5):
                try:
                    asking = socket.socket()
                    asking.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
                    asking.connect(address)
                    asking.sendall(b"GET /metrics HTTP/1.1\r\n\r\n")
                except OSError:
                    pass
                stop.wait(2)

        clients = [threading.Thread(target=drip if i < 60 else deaf, daemon=True)
                   for i in range(80)]
        for client in clients:
            client.start()
        time.sleep(1.5)
        deadline = time.monotonic() + ATTACK_S
        while time.monotonic() < deadline:
            for path in ("/metrics", "/readyz"):
                line, took = get(address, path, 10)
                slowest = max(slowest, took)
                check(line.startswith("HTTP/1.1 200"), f"{process.name} {path}: {line}")
            time.sleep(0.1)
        dropped = 0
        while dropped == 0 and time.monotonic() < deadline + 10:  # their 5 s are over then
            dropped = metrics(process).get("rips_metrics_connections_dropped_total", 0)
            time.sleep(0.5)
        stop.set()
        for client in clients:
            client.join()
        check(dropped > 0, f"{process.name} kept all slow clients")
    print(f"a scraper waited {slowest:.2f} s at worst")
    check(slowest <= 2, f"a scraper waited {slowest:.1f} s")
    fleet.unharmed()


# Listens at argv[1] as user argv[2], and keeps what it is asked.
IMPOSTOR = """
import os, socket, sys
os.setresgid(int(sys.argv[2]), int(sys.argv[2]), int(sys.argv[2]))
os.setresuid(int(sys.argv[2]), int(sys.argv[2]), int(sys.argv[2]))
listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
listener.bind(sys.argv[1])
os.chmod(sys.argv[1], 0o777)
listener.listen(8)
print("listening", flush=True)
while True:
    asking, _ = listener.accept()
    print("asked", asking.recv(1 << 16), flush=True)
"""


@quick
def a_process_that_poses_as_rips_exec(fleet):
    """Another user's process at the socket of rips-exec: it is asked nothing, and an alert names it
    before a level needs it."""
    if os.geteuid() != 0:
        print("skipped: only root can play another user")
        sys.exit(77)
    # Every directory on the way to a program must be root's alone, which /tmp is not.
    programs = pathlib.Path(tempfile.mkdtemp(prefix="rips-test-", dir="/opt"))
    try:
        pose_as_rips_exec(fleet, programs)
    finally:
        shutil.rmtree(programs)


def pose_as_rips_exec(fleet, programs):
    program = programs / "horn"
    program.write_text("#!/bin/sh\nexit 0\n")
    program.chmod(0o755)
    fleet.programs = f"programs:\n  - {{name: horn, path: {program}}}\n"
    fleet.steps = {"COMPROMISED": ["{program: {name: horn}, timeout: 2s, on_failure: continue}"]}
    fleet.arm()
    path = fleet.dir / "exec.sock"
    fleet.exec.kill()
    path.unlink(missing_ok=True)
    fleet.dir.chmod(0o1777)  # as /run/rips is to the sensor's group
    impostor = fleet.start("impostor", sys.executable, "-B", "-c", IMPOSTOR, path, NOBODY)
    impostor.wait_for(lambda line: line == "listening", 10, "the impostor listens")

    def told(text):
        return any(text in a["text"] for a in fleet.alerts())

    until(10, "no alert tells of the impostor",
          lambda: told("may pose as rips-exec") and told(f"belongs to user {NOBODY}"))
    check(metrics(fleet.actuator)["rips_actuator_helpers_refused"] == 1, "it is not counted")
    fleet.ripsctl("level", "raise", "r1", "--to", "COMPROMISED", "--reason", "test")
    until(20, "the level was not tried",
          lambda: fleet.level()["effective_level"] == "COMPROMISED")
    time.sleep(1)
    asked = [line for _, line in impostor.lines if line.startswith("asked")]
    check(not asked, f"the impostor was asked: {asked}")

    impostor.kill()
    path.unlink()
    fleet.start_exec()
    fleet.wait_level("COMPROMISED", 30)
    until(10, "it is still degraded", lambda: not fleet.level()["degraded"])
