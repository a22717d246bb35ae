"""Attacks on the port itself: with raw HTTP/2, and at most a viewer's certificate."""

import collections
import selectors
import socket
import threading
import time

import http2
from fleet import Failed, metrics
from guarded import ATTACK_S, check, quick, run_ripsctl_as, scenario

LIST_ROBOTS = b"/rips.v1.OperatorService/ListRobots"


def flood(fleet, pieces, seconds=None, reconnect=True, drain=True):
    """Sends until the server cuts it off, again and again. Gives how often it was cut off, and the
    bytes sent."""
    deadline = time.monotonic() + (seconds or ATTACK_S)
    cuts = sent = 0
    while time.monotonic() < deadline:
        try:
            client = fleet.attacker()
        except OSError:
            time.sleep(0.05)  # refused
            continue
        try:
            for piece in pieces():
                if time.monotonic() > deadline:
                    break
                client.send(piece)
                sent += len(piece)
                if drain:
                    client.drain()
        except OSError:
            cuts += 1
        finally:
            client.close()
        if not reconnect:
            break
    return cuts, sent


def flood_scenario(fleet, pieces, **options):
    fleet.arm()
    out = []
    fleet.run_beside(lambda: out.append(flood(fleet, pieces, **options)))
    cuts, sent = out[0]
    print(f"cut off {cuts} times, {sent >> 20} MiB sent")
    check(cuts > 0, f"it was never cut off, and sent {sent >> 20} MiB")
    fleet.unharmed()
    fleet.named("127.0.0.2")


@quick
def connections_that_wait(fleet):
    """1,500 connections that send six bytes; the server may open 1,024 files."""
    fleet.arm("prlimit", "--nofile=1024:1024")
    held = []

    def attack():
        for _ in range(1_500):
            waiting = socket.socket()
            waiting.settimeout(2)
            try:
                waiting.bind(("127.0.0.2", 0))
                waiting.connect(("127.0.0.1", fleet.port))
                waiting.sendall(b"PRI * ")
                held.append(waiting)
            except OSError:
                waiting.close()
        time.sleep(ATTACK_S)

    fleet.run_beside(attack)
    check(fleet.ready() == 200, "/readyz is not 200 during the attack")
    for waiting in held:
        waiting.close()
    fleet.unharmed()
    refused = sum(value for name, value in metrics(fleet.server).items()
                  if name.startswith("rips_connections_refused_total"))
    check(refused > 0, "no connection was refused")
    fleet.named("127.0.0.2")


@quick
def connections_from_everywhere(fleet):
    """From a hundred addresses, so that no limit of one address helps, and without end: 3,000 a
    second, and as soon as 1,500 are held, each new one takes the place of the oldest."""
    fleet.arm("prlimit", "--nofile=1024:1024")
    held = collections.deque()
    made = 0

    def attack():
        nonlocal made
        begun = time.monotonic()
        while time.monotonic() < begun + ATTACK_S:
            time.sleep(max(0, begun + made / 3_000 - time.monotonic()))
            waiting = socket.socket()
            waiting.settimeout(2)
            try:
                waiting.bind((f"127.{1 + made % 100}.0.1", 0))
                waiting.connect(("127.0.0.1", fleet.port))
                held.append(waiting)
            except OSError:
                waiting.close()
            made += 1
            if len(held) > 1_500:
                held.popleft().close()

    fleet.run_beside(attack)
    print(f"{made / ATTACK_S:.0f} connections a second")
    for waiting in held:
        waiting.close()
    fleet.unharmed()
    fleet.named("addresses, most from 127.")


@scenario
def hellos_that_are_left(fleet):
    """600 TLS handshakes a second are begun, from an address of their own; each costs the server a
    signature, and none goes on."""
    fleet.arm()
    hello = http2.client_hello()
    begun = 0

    def attack():
        nonlocal begun
        start = time.monotonic()
        held = collections.deque()
        while time.monotonic() < start + ATTACK_S:
            time.sleep(max(0, start + begun / 600 - time.monotonic()))
            begun += 1
            leaving = socket.socket()
            leaving.settimeout(1)
            try:
                leaving.bind(("127.0.0.2", 0))
                leaving.connect(("127.0.0.1", fleet.port))
                leaving.sendall(hello)
                held.append(leaving)
            except OSError:
                leaving.close()
            if len(held) > 64:
                held.popleft().close()
        for leaving in held:
            leaving.close()

    fleet.run_beside(attack)
    print(f"{begun / ATTACK_S:.0f} handshakes a second begun")
    fleet.unharmed()
    fleet.named("flood of connections from 127.0.0.2: 64 within")


@scenario
def hellos_from_everywhere(fleet):
    """1,200 TLS handshakes a second from a hundred addresses, so that no limit of one address
    helps; each leaves when the server has answered."""
    fleet.arm()
    hello = http2.client_hello()
    begun = answered = 0

    def attack():
        nonlocal begun, answered
        selector = selectors.DefaultSelector()
        start = time.monotonic()
        open_now = 0
        while time.monotonic() < start + ATTACK_S:
            while begun < 1_200 * (time.monotonic() - start) and open_now < 2_000:
                begun += 1
                leaving = socket.socket()
                leaving.setblocking(False)
                try:
                    leaving.bind((f"127.{1 + begun % 100}.0.1", 0))
                    leaving.connect_ex(("127.0.0.1", fleet.port))
                except OSError:
                    leaving.close()
                    continue
                selector.register(leaving, selectors.EVENT_WRITE)
                open_now += 1
            for key, event in selector.select(0.005):
                try:
                    if event & selectors.EVENT_WRITE:
                        key.fileobj.send(hello)
                        selector.modify(key.fileobj, selectors.EVENT_READ)
                        continue
                    answered += len(key.fileobj.recv(65_536)) > 0
                except OSError:
                    pass
                selector.unregister(key.fileobj)
                key.fileobj.close()
                open_now -= 1
        for key in list(selector.get_map().values()):
            key.fileobj.close()

    fleet.run_beside(attack)
    print(f"{begun / ATTACK_S:.0f} handshakes a second begun, {answered / ATTACK_S:.0f} answered")
    check(answered > 100 * ATTACK_S, "the attack did not get through to handshakes")
    fleet.unharmed()
    fleet.named("addresses, most from 127.")


@quick
def header_block_without_end(fleet):
    flood_scenario(fleet, http2.endless_header_block)


@quick
def streams_that_are_reset(fleet):
    flood_scenario(fleet, lambda: http2.streams(LIST_ROBOTS))


@scenario
def streams_of_no_method(fleet):
    flood_scenario(fleet, lambda: http2.streams(b"/no.such.Service/None"))


@scenario
def streams_without_a_path(fleet):
    flood_scenario(fleet, lambda: http2.streams(None))


@scenario
def streams_that_stay_open(fleet):
    flood_scenario(fleet, lambda: http2.streams(LIST_ROBOTS, resets=False))


@scenario
def pings_without_end(fleet):
    flood_scenario(fleet, http2.pings)


@scenario
def settings_that_are_not_read(fleet):
    flood_scenario(fleet, http2.settings, drain=False)


@quick
def four_at_a_time(fleet):
    """Endless header blocks over four connections, each made anew when it is cut off."""
    fleet.arm()
    cuts = []

    def attack():
        threads = [threading.Thread(
            target=lambda: cuts.append(flood(fleet, http2.endless_header_block)))
            for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    fleet.run_beside(attack)
    print(f"cut off {sum(c for c, _ in cuts)} times, {sum(s for _, s in cuts) >> 20} MiB sent")
    fleet.unharmed()
    fleet.named("127.0.0.2")


@quick
def a_stolen_key_is_throttled(fleet):
    """A viewer who was identified and then floods is named, and refused for a while."""
    fleet.arm()
    client = fleet.attacker()
    empty = b"\x00\x00\x00\x00\x00"
    client.send(http2.call(1, LIST_ROBOTS) +
                http2.frame(0, http2.END_STREAM, 1, empty))
    time.sleep(0.5)
    client.drain()
    try:
        for i in range(3, 2_003, 2):
            client.send(http2.call(i, LIST_ROBOTS) + http2.reset(i))
        # Until the server has read them, it has nothing against them.
        for _ in range(50):
            time.sleep(0.2)
            client.send(http2.frame(http2.PING, 0, 0, b"12345678"))
        raise Failed("a thousand calls in a moment were not too many")
    except OSError:
        pass
    fleet.unharmed()
    fleet.named("127.0.0.2", "operator/viewer/mallory")
    # From an address that is not banned.
    pki = fleet.key()
    code, _, error = run_ripsctl_as(fleet, pki)
    check(code == 1 and "try again in" in error, f"the key is not refused: {code} {error}")
