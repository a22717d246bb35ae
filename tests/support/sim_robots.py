"""Many robots in one process: of each a sensor and an actuator, as streams over real mutual TLS to a
real policy server. No DDS: what a sensor sees is what the test says.

    robots = SimRobots(port, pki, ["r01", "r02"], levels=("DEFAULT", "ALERT"))
    robots.start()                    # their heartbeats run in a thread
    robots["r01"].signal("SIGUSR1")   # an observation of its sensor
    robots["r02"].silent = True       # its sensor says nothing any more
"""

import os
import pathlib
import sys
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "redteam"))
from peer import Ended, Peer, pb  # noqa: E402

BEAT_S = 0.5
CONTROL = 1  # the lane of signals


def boottime_ns():
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def set_clock(message):
    message.clock.boottime_ns = boottime_ns()
    message.clock.unix_ns = time.time_ns()


class SimRobot:
    """Not thread-safe but for signal() and `silent`."""

    def __init__(self, port, pki, name, levels, source):
        self.port, self.pki, self.name, self.levels = port, pathlib.Path(pki), name, levels
        self.source = source
        self.silent = False
        self.level = levels[0]
        self.lost = 0  # streams
        self.incarnation = os.urandom(16)
        self.sequence = 1
        self.signals = []
        self.lock = threading.Lock()
        self.sensor = self.actuator = None

    def signal(self, name):
        with self.lock:
            self.signals.append(name)

    def step(self):
        """Sends what is due and answers what has come; connects anew if a stream was lost."""
        try:
            if self.sensor is None:
                self._connect()
            self._beat()
            self._send_signals()
            for reply in self.actuator.messages(pb("ActuatorReply"), 0):
                if reply.WhichOneof("kind") == "command":
                    self._obey(reply.command)
            for reply in self.sensor.messages(pb("SensorReply"), 0):
                if reply.WhichOneof("kind") == "interest":
                    message = pb("SensorMessage")()
                    message.interest_applied.interest = reply.interest.id
                    self.sensor.send(message)
            if self.sensor.status or self.actuator.status:
                raise Ended(f"{self.sensor.status} {self.actuator.status}")
        except (Ended, OSError, TimeoutError):
            self.lost += 1
            self.close()

    def close(self):
        for stream in (self.sensor, self.actuator):
            if stream is not None:
                stream.peer.close()
        self.sensor = self.actuator = None

    def _connect(self):
        sensor = Peer(self.port, self.pki / "sensor" / self.name / "base", self.source)
        actuator = Peer(self.port, self.pki / "actuator" / self.name / "base", self.source)
        self.sensor = sensor.call("rips.v1.SensorService", "Observe")
        self.actuator = actuator.call("rips.v1.ActuatorService", "Attach")
        hello = pb("SensorMessage")()
        self._greet(hello.hello.hello, self.incarnation)
        self.sensor.send(hello)
        hello = pb("ActuatorMessage")()
        self._greet(hello.hello.hello, os.urandom(16))
        hello.hello.levels.extend(self.levels)
        hello.hello.fail_safe_level = hello.hello.effective_level = self.level
        self.actuator.send(hello)
        # The graph: one node, settled.
        def settled(observation):
            observation.snapshot.graph_version = 1
            observation.snapshot.settled = True
            # One node, so that the robot is not blind.
            participant = observation.snapshot.participants.add(host="base", vendor="0110")
            participant.guid = os.urandom(12) + bytes.fromhex("000001c1")
            observation.snapshot.nodes.add(full_name="/base", participant_guid=participant.guid)
        self._observe(settled)

    def _greet(self, hello, incarnation):
        hello.protocol = 1
        hello.incarnation = incarnation
        hello.host = "base"
        set_clock(hello)

    def _beat(self):
        if not self.silent:
            message = pb("SensorMessage")()
            set_clock(message.heartbeat)
            self.sensor.send(message)
        message = pb("ActuatorMessage")()
        set_clock(message.heartbeat.heartbeat)
        message.heartbeat.effective_level = self.level
        message.heartbeat.verified = True
        self.actuator.send(message)

    def _send_signals(self):
        with self.lock:
            signals, self.signals = self.signals, []
        for name in signals:
            self._observe(lambda each, name=name: setattr(each.signal, "name", name))

    def _observe(self, fill):
        message = pb("SensorMessage")()
        message.batch.incarnation, message.batch.lane = self.incarnation, CONTROL
        message.batch.first_sequence = self.sequence
        message.batch.base_boottime_ns = boottime_ns()
        fill(message.batch.observations.add())
        self.sequence += 1
        self.sensor.send(message)

    def _obey(self, command):
        if command.WhichOneof("kind") == "set_level":
            self.level = command.set_level.to
        receipt = pb("ActuatorMessage")()
        receipt.receipt.command_id = command.id
        receipt.receipt.decision_id.CopyFrom(command.set_level.decision_id)
        receipt.receipt.stage = pb("Receipt").VERIFIED
        receipt.receipt.effective_level = self.level
        self.actuator.send(receipt)


class SimRobots:
    """`names` to SimRobot; steps all of them twice a second in a thread until stop()."""

    def __init__(self, port, pki, names, levels, source="127.0.0.5"):
        self._robots = {name: SimRobot(port, pki, name, levels, source) for name in names}
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __getitem__(self, name):
        return self._robots[name]

    def start(self):
        self._thread.start()

    def stop(self):
        self._over.set()
        self._thread.join(20)
        for robot in self._robots.values():
            robot.close()

    def _run(self):
        while not self._over.is_set():
            begun = time.monotonic()
            for robot in self._robots.values():
                robot.step()
            self._over.wait(max(0.05, BEAT_S - (time.monotonic() - begun)))
