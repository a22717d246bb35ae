"""Agents that start while another robot is attacked: one after the other connects as the sensor of a
robot that has just booted, from an address that the server has not seen, and waits for the answer
to its hello. Refused ones try again at once, as long as it takes.

    newcomer.py PORT PKI

On SIGTERM it starts the last one and prints how long each took, in seconds, as one line of JSON.
"""

import json
import os
import pathlib
import signal
import sys
import threading
import time

from peer import Ended, Peer, pb
from probe import fill

# An agent's certificate begins two streams a second at most.
PERIOD_S = 1.0
RETRY_S = 0.1
PATIENCE_S = 30


def source(number):
    return f"127.200.{number // 200 % 200}.{1 + number % 200}"


def admitted(port, pki, address):
    """True once the server has answered the hello; False if it refuses the connection."""
    try:
        peer = Peer(port, pki, address)
    except OSError:
        return False
    try:
        stream = peer.call("rips.v1.SensorService", "Observe")
        hello = pb("SensorMessage")()
        fill(hello.hello.hello, os.urandom(16))
        stream.send(hello)
        return bool(stream.messages(pb("SensorReply"), PATIENCE_S, count=1))
    except (Ended, OSError):
        return False
    finally:
        peer.close()


def start(port, pki, number):
    """Seconds until the agent is admitted."""
    begun = time.monotonic()
    while not admitted(port, pki, source(number)) and time.monotonic() - begun < PATIENCE_S:
        time.sleep(RETRY_S)
    return time.monotonic() - begun


def main():
    port, pki = int(sys.argv[1]), pathlib.Path(sys.argv[2])
    stopping = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stopping.set())
    seconds = []
    while not stopping.is_set():
        seconds.append(start(port, pki, len(seconds)))
        stopping.wait(max(0, PERIOD_S - seconds[-1]))
    seconds.append(start(port, pki, len(seconds)))
    print(json.dumps({"seconds": seconds}), flush=True)


if __name__ == "__main__":
    main()
