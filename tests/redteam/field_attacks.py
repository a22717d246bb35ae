"""Fields as long as a message may be, and numbers that no clock shows: from a robot's agents.

Robot r2 stands in the inventory and no agent of it runs: the attacker has its keys. Robot r1 is under
guard. What r2's keys may cost: no answer to an operator, at most 50 MiB of disk, less than 1 GiB of
memory; and an alert names them.
"""

import time

from fleet import Failed, metrics
from guarded import ATTACK_S, check, quick, scenario
from peer import Ended, Peer, pb

LONG = "x" * (4_000_000)
INVALID_ARGUMENT = "3"
ALREADY_EXISTS = "6"
MOST = (1 << 64) - 1


class Attacked:
    """The fleet with r2, and what r2's keys did to it."""

    def __init__(self, fleet, role):
        self.fleet = fleet
        self.role = role
        fleet.stolen = {"r2": ("sensor", "actuator")}
        fleet.arm()
        self.refused = self.taken = self.opened = 0

    def open(self):
        """A stream with r2's key, before its hello: a new certificate from another address each
        time, since one whose message is refused is banned."""
        self.fleet.mint("--renew", self.role, "r2", "base")
        self.opened += 1
        key = self.fleet.dir / "pki" / self.role / "r2" / "base"
        service, method = {"sensor": ("SensorService", "Observe"),
                           "actuator": ("ActuatorService", "Attach")}[self.role]
        deadline = time.monotonic() + 10
        while True:
            try:
                peer = Peer(self.fleet.port, key, f"127.0.9.{1 + self.opened % 250}")
                return peer, peer.call(f"rips.v1.{service}", method)
            except OSError:  # too many connections for the moment
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.2)

    def send(self, messages):
        """One stream of these messages. Gives its status, None if the server takes them all."""
        for _ in range(20):
            status = self.send_once(messages)
            if status is None or status[0] != ALREADY_EXISTS:
                break
            time.sleep(0.2)  # the stream before is not over yet
        if status is None:
            self.taken += 1
        else:
            self.refused += 1
        return status

    def send_once(self, messages):
        peer, stream = self.open()
        try:
            for message in messages:
                stream.send(message)
            reply = pb("SensorReply" if self.role == "sensor" else "ActuatorReply")
            deadline = time.monotonic() + 1.5
            while stream.status is None and peer.problem is None and time.monotonic() < deadline:
                stream.messages(reply, 0.1)
        except Ended:
            for _ in range(20):
                if stream.status is not None:
                    break
                time.sleep(0.05)
        problem = peer.problem
        peer.close()
        ended = stream.status is not None or problem is not None
        return (stream.status or (None, problem)) if ended else None

    def operator(self):
        """What an operator asks of the whole fleet, and of r2."""
        robots = {r["robot"]: r for r in self.fleet.query("robot", "list")["robots"]}
        check(set(robots) == {"new", "probe", "r1", "r2"},
              f"not the robots of the inventory: {sorted(robots)}")
        for verb in (("robot", "coverage", "r2"), ("robot", "interest", "r2"),
                     ("level", "show", "r2"),
                     ("level", "history", "r2", "--limit", "1000"),
                     ("alert", "list", "--limit", "1000")):
            code, _, error = self.fleet.ripsctl(*verb, check=False)
            check(code == 0 or verb[1] == "coverage" and code == 1, f"{verb}: {code} {error}")

    def harmless(self):
        self.operator()
        print(f"{self.refused} streams refused, {self.taken} taken")
        self.fleet.unharmed()

    def named(self, *fields):
        """An alert of r2 names the peer; the counters know each field."""
        told = [a["text"] for a in self.fleet.query("alert", "list", "r2", "--limit", "1000")["alerts"]]
        mine = [text for text in told if "sent a message past a limit" in text]
        check(mine, f"no alert names the peer: {told}")
        check(any(f"{self.role} r2/base at ipv4:127.0.9." in text for text in mine),
              f"no alert says who it was: {mine}")
        check(not any("xxxx" in text for text in told), "an alert holds what was sent")
        counted = metrics(self.fleet.server).get("rips_fields_refused_total", 0)
        check(counted >= len(fields), f"{counted} fields were counted as refused")
        for field in fields:
            # Of many at once some alerts are folded; the log has each.
            refused = [line for _, line in self.fleet.server.lines if "stream refused" in line]
            check(any(field in text for text in [*mine, *refused]),
                  f"neither alert nor log names {field}: {mine}")


def hello(role, **more):
    if role == "sensor":
        message = pb("SensorMessage")()
        base = message.hello.hello
    else:
        message = pb("ActuatorMessage")()
        base = message.hello.hello
        message.hello.levels.extend(["DEFAULT", "ALERT", "COMPROMISED", "HALT"])
        message.hello.effective_level = "DEFAULT"
    base.protocol = 1
    base.incarnation = bytes(16)
    base.host = "base"
    base.clock.boottime_ns = 10**9
    base.clock.unix_ns = time.time_ns()
    for name, value in more.items():
        where = message.hello
        *path, last = name.split("__")
        for step in path:
            where = getattr(where, step)
        if isinstance(value, list):
            getattr(where, last).extend(value)
        else:
            setattr(where, last, value)
    return message


def heartbeat(**fields):
    message = pb("ActuatorMessage")()
    message.heartbeat.heartbeat.clock.boottime_ns = fields.pop("boottime_ns", 10**9)
    message.heartbeat.heartbeat.clock.unix_ns = fields.pop("unix_ns", 0)
    message.heartbeat.effective_level = "DEFAULT"
    for name, value in fields.items():
        if isinstance(value, list):
            getattr(message.heartbeat, name).extend(value)
        else:
            setattr(message.heartbeat, name, value)
    return message


def receipt(detail="", step="", output=b""):
    message = pb("ActuatorMessage")()
    message.receipt.stage = 3
    message.receipt.detail = detail
    message.receipt.output_tail = output
    if step:
        message.receipt.steps.add().step = step
    return message


def beside(attacked, attack):
    """For ATTACK_S and at least once; the guarded robot's operator is served meanwhile."""
    def go():
        deadline = time.monotonic() + ATTACK_S
        while True:
            attack()
            if time.monotonic() > deadline:
                return
    attacked.fleet.run_beside(go)


def expect_refusal(attacked, field, messages):
    status = attacked.send(messages)
    if status is None:
        raise Failed(f"{field} was taken")
    code, text = status
    # Statuses are Huffman-coded unless short; the code is what can be read.
    check(code in (INVALID_ARGUMENT, None), f"{field}: refused with {code} {text!r}")


@quick
def actuator_fields(fleet):
    """Each text of an actuator 4 MB long, and lists and times that cannot be."""
    attacked = Attacked(fleet, "actuator")
    start = hello("actuator")
    cases = {
        "ActuatorHeartbeat.floor_reason": [start, heartbeat(floor_reason=LONG)],
        "ActuatorHeartbeat.observed": [start, heartbeat(observed=LONG, drifts=1)],
        "ActuatorHeartbeat.degraded": [start, heartbeat(degraded=[LONG])],
        "ActuatorHello.levels": [hello("actuator", levels=[LONG[:60_000] + str(i)
                                                         for i in range(60)])],
        "ActuatorHello.programs": [hello("actuator", programs=["p" * 4_000] * 900)],
        "ActuatorHello.decided_level": [hello("actuator", decided_level=LONG)],
        "Hello.version": [hello("actuator", hello__version=LONG)],
        "Receipt.detail": [start, receipt(detail=LONG)],
        "StepResult.step": [start, receipt(step=LONG)],
        "Receipt.output_tail": [start, receipt(output=LONG.encode())],
        "Clock.boottime_ns": [start, heartbeat(boottime_ns=MOST)],
        "Clock.unix_ns": [start, heartbeat(unix_ns=-1)],
    }

    def attack():
        for field, messages in cases.items():
            expect_refusal(attacked, field, messages)

    beside(attacked, attack)
    attacked.harmless()
    attacked.named("ActuatorHeartbeat.floor_reason", "ActuatorHello.levels", "Receipt.detail")


@quick
def actuator_texts_at_their_limits(fleet):
    """What the limits let through, as fast as a stream takes it: RIPS's own alerts are limited."""
    attacked = Attacked(fleet, "actuator")

    def attack():
        peer, stream = attacked.open()
        deadline = time.monotonic() + max(ATTACK_S, 3)
        number = 0
        try:
            stream.send(hello("actuator"))
            while time.monotonic() < deadline:
                number += 1
                def text(size):
                    return f"{number}: ".ljust(size, "x")
                stream.send(heartbeat(boottime_ns=10**9 + number, observed=text(4_096), drifts=number,
                                 floor_reason=text(1_024) if number % 2 else "",
                                 degraded=[f"{i}-" + text(250 - len(str(i))) for i in range(8)]
                                 if number % 2 else []))
                time.sleep(0.001)
        except (Ended, TimeoutError):
            pass  # it was too fast; it comes again
        finally:
            peer.close()
        attacked.taken += 1
        time.sleep(0.1)

    beside(attacked, attack)
    attacked.harmless()
    fleet.told_of("r2", "actuator base has a floor of its own")


def snapshot(**fields):
    """A batch of the control lane with one graph snapshot."""
    message = pb("SensorMessage")()
    message.batch.incarnation = bytes(16)
    message.batch.first_sequence = 1
    message.batch.base_boottime_ns = 10**9
    message.batch.lane = 1
    graph = message.batch.observations.add().snapshot
    graph.graph_version = 1
    graph.settled = True
    for each in fields.get("participants", []):
        graph.participants.add(**each)
    for each in fields.get("endpoints", []):
        partitions = each.pop("partitions", [])
        graph.endpoints.add(**each).qos.partitions.extend(partitions)
    return message


def participant(number, **more):
    return {"guid": b"\x01\x10" + number.to_bytes(4, "big") + bytes(6) + b"\x00\x00\x01\xc1", **more}


def endpoint(number, of=0, **more):
    guid = (b"\x01\x10" + of.to_bytes(4, "big") + bytes(6) + number.to_bytes(3, "big") + b"\x03")
    return {"guid": guid, "kind": 1, "name": f"/t{number % 4_000}", "type": "std_msgs/msg/String",
            "ros": True, **more}


def observed(set_fields):
    message = pb("SensorMessage")()
    message.batch.incarnation = bytes(16)
    message.batch.first_sequence = 1
    message.batch.base_boottime_ns = 10**9
    message.batch.lane = 1
    set_fields(message.batch)
    return message


@scenario
def sensor_fields(fleet):
    """Each text of a sensor as long as a message lets it be, and times and counts that overflow."""
    attacked = Attacked(fleet, "sensor")
    start = hello("sensor")

    def loss(batch, count=MOST, first=1):
        one = batch.observations.add().loss
        one.count, one.first_boottime_ns, one.cause = count, first, 2

    def late(batch):
        batch.base_boottime_ns = MOST
        batch.observations.add(offset_ns=5).signal.name = "SIGUSR1"

    def applied(**fields):
        message = pb("SensorMessage")()
        message.interest_applied.SetInParent()
        for name, value in fields.items():
            setattr(message.interest_applied, name, value)
        return message

    cases = {
        "Participant.host": [start, snapshot(participants=[participant(1, host=LONG)])],
        "Participant.enclave": [start, snapshot(participants=[participant(1, enclave=LONG)])],
        "Participant.vendor": [start, snapshot(participants=[participant(1, vendor=LONG)])],
        "Endpoint.why": [start, snapshot(participants=[participant(0)],
                                         endpoints=[endpoint(1, why=LONG)])],
        "Qos.partitions": [start, snapshot(participants=[participant(0)],
                                           endpoints=[endpoint(1, partitions=["p"] * 1_000_000)])],
        "GraphSnapshot.participants": [start, snapshot(participants=[participant(i)
                                                                      for i in range(60_000)])],
        "SensorHello.blind": [hello("sensor", blind=[LONG])],
        "SensorHello.not_visible": [hello("sensor", not_visible=["n"] * 100_000)],
        "InterestApplied.problem": [start, applied(interest=bytes(32), problem=LONG)],
        "Loss.count": [start, observed(loss)],
        "Loss.first_boottime_ns": [start, observed(lambda b: loss(b, 1, MOST))],
        "ObservationBatch.base_boottime_ns": [start, observed(late)],
        "Clock.boottime_ns": [hello("sensor", hello__clock__boottime_ns=MOST)],
        "Finding.kind": [start, observed(lambda b: setattr(
            b.observations.add().finding, "kind", LONG))],
        "SignalSeen.name": [start, observed(lambda b: setattr(
            b.observations.add().signal, "name", LONG))],
    }

    def attack():
        for field, messages in cases.items():
            expect_refusal(attacked, field, messages)

    beside(attacked, attack)
    attacked.harmless()
    attacked.named("Participant.host", "Endpoint.why", "Loss.count")


@scenario
def sensor_graph_at_its_limits(fleet):
    """The largest graph that the limits let through, sent again and again: memory is bounded, and
    what does not fit into an answer is left out of it."""
    attacked = Attacked(fleet, "sensor")
    partitions = [f"{i}".ljust(128, "p") for i in range(16)]

    def delta(version, first, count):
        message = pb("SensorMessage")()
        message.batch.incarnation = bytes(16)
        message.batch.first_sequence = version
        message.batch.base_boottime_ns = 10**9
        message.batch.lane = 1
        change = message.batch.observations.add().delta
        change.from_version, change.to_version, change.settled = version - 1, version, True
        for number in range(first, first + count):
            one = endpoint(number, why="w" * 512, type="t" * 512)
            one["name"] = f"/t{number % 4_000}_".ljust(250, "n")
            change.upsert_endpoints.add(**one).qos.partitions.extend(partitions)
        return message

    def attack():
        peer, stream = attacked.open()
        try:
            stream.send(hello("sensor"))
            stream.messages(pb("SensorReply"), 1, count=2)
            stream.send(snapshot(participants=[participant(i, host="h" * 512, enclave="e" * 512)
                                               for i in range(2_048)]))
            for version in range(2, 18):
                stream.send(delta(version, 1_000 * (version - 2), 1_000))
            time.sleep(1)
            check(stream.status is None, f"the graph was refused: {stream.status}")
            attacked.operator()
            attacked.taken += 1
        finally:
            peer.close()
        time.sleep(2)  # until its session is stale

    beside(attacked, attack)
    coverage = fleet.ripsctl("--output", "json", "robot", "coverage", "r2", check=False)[1]
    check('"endpoints_left_out"' in coverage, "coverage does not say what it leaves out")
    attacked.harmless()
    fleet.told_of("r2", "not on the list of known nodes")
