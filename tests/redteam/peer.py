"""A hostile gRPC peer with a valid certificate: calls and streams of protobuf messages, over the raw
HTTP/2 client, so that nothing on our side keeps its rules.

    peer = Peer(port, pki, source)
    stream = peer.call("rips.v1.SensorService", "Observe")
    stream.send(pb("SensorMessage")(...))      # or bytes, which need not be a message
    for message in stream.messages(pb("SensorReply"), seconds=2): ...
    stream.status                              # (code, message) once the server has ended it
"""

import pathlib
import socket
import struct
import sys
import threading
import time

import http2

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "support"))
from protos import pb  # noqa: E402, F401

DATA, GOAWAY, WINDOW_UPDATE = 0, 7, 8
ACK = 1
PADDED, PRIORITY = 8, 32
WINDOW = (1 << 31) - 1


class Ended(OSError):
    """The server has ended the stream or the connection."""


class Stream:
    def __init__(self, peer, number):
        self.peer = peer
        self.number = number
        self.window = 65_535  # what the server lets us send
        self.received = []  # whole messages, bytes
        self.status = None  # (code, message)
        self._partial = b""

    def send(self, message, last=False):
        """Sends one message, as the server's windows allow; Ended once it has had enough."""
        body = message if isinstance(message, bytes) else message.SerializeToString()
        self.send_raw(struct.pack(">BI", 0, len(body)) + body, last)

    def send_raw(self, data, last=False):
        peer = self.peer
        while True:
            with peer.changed:
                deadline = time.monotonic() + 10
                while self.window <= 0 or peer.window <= 0:
                    self._check()
                    if not peer.changed.wait(deadline - time.monotonic()):
                        raise TimeoutError("the server grants no window")
                self._check()
                length = min(len(data), self.window, peer.window, 16_384)
                self.window -= length
                peer.window -= length
            piece, data = data[:length], data[length:]
            flags = http2.END_STREAM if last and not data else 0
            peer.write(http2.frame(DATA, flags, self.number, piece))
            if not data:
                return

    def _check(self):
        if self.status is not None:
            raise Ended(f"the server ended the stream: {self.status}")
        if self.peer.problem is not None:
            raise Ended(f"the connection ended: {self.peer.problem}")

    def messages(self, kind, seconds, count=None):
        """Parsed messages that come within `seconds`, at most `count`."""
        out = []
        deadline = time.monotonic() + seconds
        while count is None or len(out) < count:
            with self.peer.changed:
                while not self.received:
                    left = deadline - time.monotonic()
                    if left <= 0 or self.status or self.peer.problem:
                        return out
                    self.peer.changed.wait(left)
                body = self.received.pop(0)
            out.append(kind.FromString(body))
        return out

    def on_data(self, data):
        self._partial += data
        while len(self._partial) >= 5:
            _, length = struct.unpack(">BI", self._partial[:5])
            if len(self._partial) < 5 + length:
                return
            self.received.append(self._partial[5:5 + length])
            self._partial = self._partial[5 + length:]


class Peer:
    """One connection; `pki`: a folder with ca.pem, cert.pem and key.pem. With `reads=False` it never
    opens the server's windows beyond the first 64 KiB of each stream."""

    def __init__(self, port, pki, source="127.0.0.2", reads=True):
        self.client = http2.Client(port, pki, source)
        self.client.tls.raw.settimeout(None)
        self.address = self.client.address
        self.reads = reads
        self.changed = threading.Condition()
        self.window = 65_535
        self.initial = 65_535
        self.problem = None
        self.streams = {}
        self._next = 1
        self._write_lock = threading.Lock()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        if reads:
            self.write(http2.frame(WINDOW_UPDATE, 0, 0, struct.pack(">I", WINDOW - 65_535)))

    def write(self, data):
        try:
            with self._write_lock:
                self.client.send(data)
        except (OSError, ValueError) as error:
            raise Ended(str(error)) from error

    def call(self, service, method):
        with self.changed:
            stream = Stream(self, self._next)
            stream.window = self.initial
            self.streams[self._next] = stream
            self._next += 2
        self.write(http2.call(stream.number, f"/{service}/{method}".encode()))
        if self.reads:
            self.write(http2.frame(WINDOW_UPDATE, 0, stream.number,
                                   struct.pack(">I", WINDOW - 65_535)))
        return stream

    def ask(self, service, method, request, reply, seconds=10):
        """A unary call: (reply or None, status)."""
        stream = self.call(service, method)
        stream.send(request, last=True)
        got = stream.messages(reply, seconds, count=1)
        with self.changed:
            deadline = time.monotonic() + seconds
            while stream.status is None and self.problem is None:
                if not self.changed.wait(max(0, deadline - time.monotonic())):
                    break
            self.streams.pop(stream.number, None)
        return (got[0] if got else None), stream.status

    def close(self):
        """Ends the connection; first the reader's call, which would keep it open."""
        try:
            self.client.tls.raw.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass
        self._reader.join(5)
        self.client.close()

    def _read(self):
        buffer = b""
        try:
            while True:
                data = self.client.tls.recv(1 << 16)
                if not data:
                    raise OSError("closed by the server")
                buffer += data
                while len(buffer) >= 9:
                    length = int.from_bytes(buffer[:3], "big")
                    if len(buffer) < 9 + length:
                        break
                    self._on_frame(buffer[3], buffer[4],
                                   int.from_bytes(buffer[5:9], "big") & 0x7FFFFFFF,
                                   buffer[9:9 + length])
                    buffer = buffer[9 + length:]
        except (OSError, ValueError) as error:
            with self.changed:
                self.problem = str(error)
                self.changed.notify_all()

    def _on_frame(self, kind, flags, number, payload):
        answer = b""
        with self.changed:
            stream = self.streams.get(number)
            if kind == DATA and stream:
                stream.on_data(payload)
            elif kind == http2.HEADERS and stream and flags & http2.END_STREAM:
                stream.status = _status(payload)
            elif kind == http2.RST_STREAM and stream:
                stream.status = stream.status or (None, "reset")
            elif kind == http2.SETTINGS and not flags & ACK:
                self._on_settings(payload)
                answer = http2.frame(http2.SETTINGS, ACK, 0)
            elif kind == http2.PING and not flags & ACK:
                answer = http2.frame(http2.PING, ACK, 0, payload)
            elif kind == WINDOW_UPDATE:
                more = struct.unpack(">I", payload)[0]
                if number == 0:
                    self.window += more
                elif stream:
                    stream.window += more
            elif kind == GOAWAY:
                self.problem = "GOAWAY: " + payload[8:].decode("utf-8", "replace")
            self.changed.notify_all()
        if answer:
            self.write(answer)

    def _on_settings(self, payload):
        for at in range(0, len(payload), 6):
            setting, value = struct.unpack(">HI", payload[at:at + 6])
            if setting == 4:
                for stream in self.streams.values():
                    stream.window += value - self.initial
                self.initial = value


def _status(block):
    """What the trailers say, as far as it can be read without HPACK's Huffman code."""
    at = block.find(b"grpc-status")
    code = None
    if at >= 0:
        value = block[at + 11:]
        code = value[1:1 + value[0]].decode("latin-1")
    at = block.find(b"grpc-message")
    text = block[at + 12:].decode("latin-1")[1:] if at >= 0 else ""
    return code, text
