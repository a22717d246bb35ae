"""A robot that measures how long a verdict takes while another one is attacked.

    probe.py PORT PKI

It is the sensor and the actuator of robot `probe` in one process: twenty times a second it reports
a signal, for which the rules run a program, and takes the time until the command arrives. Two signals
take turns, since a program that runs already is not run twice. On SIGTERM it prints the times, in
seconds, as one line of JSON; a line `lost: why` says that a stream was lost. See guarded.py for its
rules.
"""

import json
import os
import pathlib
import signal
import sys
import threading
import time

from peer import Ended, Peer, pb

PERIOD_S = 0.05
BEAT_S = 0.5
ANSWER_S = 30
# An address of its own: what is done to the attacker's is not done to it.
SOURCE = "127.0.0.3"
LEVELS = ("DEFAULT", "ALERT")


def boottime_ns():
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def fill(hello, incarnation):
    hello.protocol = 1
    hello.incarnation = incarnation
    hello.host = "base"
    hello.clock.boottime_ns = boottime_ns()
    hello.clock.unix_ns = time.time_ns()


def fill_heartbeat(heartbeat):
    heartbeat.clock.boottime_ns = boottime_ns()
    heartbeat.clock.unix_ns = time.time_ns()


class Probe:
    def __init__(self, port, pki):
        self.port = port
        self.pki = pathlib.Path(pki)
        self.seconds = []
        self.stopping = threading.Event()

    def run(self):
        """Until `stopping`; begins anew when a stream is lost."""
        asked = time.monotonic()
        while not self.stopping.is_set():
            try:
                self.connect()
                while not self.stopping.is_set():
                    asked = time.monotonic()
                    self.ask()
                    took = time.monotonic() - asked
                    if not self.seconds:
                        print("begun", flush=True)
                    self.seconds.append(took)
                    time.sleep(max(0, PERIOD_S - took))
            except (Ended, TimeoutError, OSError) as error:
                print(f"lost: {error}", flush=True)
                self.seconds.append(time.monotonic() - asked)
                time.sleep(0.2)

    def connect(self):
        self.beaten = 0.0
        self.sequence = 1
        self.incarnation = os.urandom(16)
        self.actuator = Peer(self.port, self.pki / "actuator/probe/base", SOURCE).call(
            "rips.v1.ActuatorService", "Attach")
        hello = pb("ActuatorMessage")()
        fill(hello.hello.hello, os.urandom(16))
        hello.hello.levels.extend(LEVELS)
        hello.hello.fail_safe_level = hello.hello.effective_level = LEVELS[0]
        hello.hello.programs.append("answer")
        self.actuator.send(hello)
        self.sensor = Peer(self.port, self.pki / "sensor/probe/base", SOURCE).call(
            "rips.v1.SensorService", "Observe")
        hello = pb("SensorMessage")()
        fill(hello.hello.hello, self.incarnation)
        self.sensor.send(hello)
        for stream, reply in ((self.actuator, "ActuatorReply"), (self.sensor, "SensorReply")):
            if not stream.messages(pb(reply), 10, count=1):
                raise TimeoutError("no answer to a hello")

    def ask(self):
        self.heartbeat()
        message = pb("SensorMessage")()
        batch = message.batch
        batch.incarnation, batch.lane, batch.first_sequence = self.incarnation, 1, self.sequence
        batch.base_boottime_ns = boottime_ns()
        turn = str(1 + self.sequence % 2)
        batch.observations.add().signal.name = "SIGUSR" + turn
        self.sequence += 1
        self.sensor.send(message)
        self.sensor.received.clear()
        deadline = time.monotonic() + ANSWER_S
        while time.monotonic() < deadline:
            for reply in self.actuator.messages(pb("ActuatorReply"), 0.25, count=1):
                if reply.WhichOneof("kind") != "command":
                    continue
                self.obey(reply.command)
                if turn in reply.command.run_program.args:
                    return
            self.heartbeat()
        raise TimeoutError(f"no verdict in {ANSWER_S} s")

    def obey(self, command):
        receipt = pb("ActuatorMessage")()
        receipt.receipt.command_id = command.id
        receipt.receipt.decision_id.CopyFrom(command.set_level.decision_id)
        receipt.receipt.stage = pb("Receipt").VERIFIED
        receipt.receipt.effective_level = LEVELS[0]
        self.actuator.send(receipt)

    def heartbeat(self):
        if time.monotonic() - self.beaten < BEAT_S:
            return
        self.beaten = time.monotonic()
        message = pb("SensorMessage")()
        fill_heartbeat(message.heartbeat)
        self.sensor.send(message)
        message = pb("ActuatorMessage")()
        fill_heartbeat(message.heartbeat.heartbeat)
        message.heartbeat.effective_level = LEVELS[0]
        message.heartbeat.verified = True
        self.actuator.send(message)


def main():
    probe = Probe(int(sys.argv[1]), sys.argv[2])
    signal.signal(signal.SIGTERM, lambda *_: probe.stopping.set())
    probe.run()
    print(json.dumps({"seconds": probe.seconds}), flush=True)


if __name__ == "__main__":
    main()
