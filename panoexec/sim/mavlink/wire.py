"""MAVLink framing on UDP and TCP sockets and between components of one process.

Sockets are read and written directly from the event loop, and frames of one moment share a datagram, as autopilots do:
at a speed-up of 20 a mission's streams are some 4000 messages per second.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias
from urllib.parse import urlsplit

from panoexec.errors import LinkError, UsageError
from panoexec.sim.mavlink.dialect import mavlink

Message: TypeAlias = Any
"""A pymavlink message; pymavlink has no type annotations."""

_BUFFER_BYTES = 1 << 20
_DATAGRAM_BYTES = 65535
_PACKET_BYTES = 1400


class Receiver(Protocol):
    """Handles the messages of a link."""

    def __call__(self, message: Message, frame: bytes, /) -> None:
        """Handle a message and the bytes of its frame."""
        ...


class Link(Protocol):
    """A connection to other MAVLink components."""

    name: str

    def send(self, frame: bytes, message: Message) -> None:
        """Send one packed message; never blocks, may drop it."""
        ...


class Sender:
    """The identity of a component: packs messages with its ids and its own sequence number."""

    def __init__(self, system_id: int, component_id: int) -> None:
        self.system_id = system_id
        self.component_id = component_id
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)

    def pack(self, message: Message) -> bytes:
        """The frame of a message; increments the sequence number."""
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame


class LocalLink:
    """One of two connected ends in one process; a message sent on one is received on the other, unparsed, at once."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.peer: LocalLink | None = None
        self.receiver: Receiver | None = None

    @staticmethod
    def pair(name_a: str, name_b: str) -> tuple[LocalLink, LocalLink]:
        """Two connected ends."""
        a, b = LocalLink(name_a), LocalLink(name_b)
        a.peer, b.peer = b, a
        return a, b

    def send(self, frame: bytes, message: Message) -> None:
        """See `Link.send`."""
        peer = self.peer
        if peer is not None and peer.receiver is not None:
            peer.receiver(message, frame)


def _parser() -> Any:
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return parser


class _SocketLink(ABC):
    """Common part of UDP and TCP links.

    Attributes:
        lost: frames that could not be sent.
    """

    def __init__(self, name: str, sock: socket.socket) -> None:
        self.name = name
        self.receiver: Receiver | None = None
        self.lost = 0
        self._socket = sock
        self._socket.setblocking(False)
        self._parser = _parser()
        self._outgoing = bytearray()
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(sock.fileno(), self._readable)

    @property
    def local_port(self) -> int:
        """The port at this end."""
        return int(self._socket.getsockname()[1])

    def send(self, frame: bytes, message: Message) -> None:
        """See `Link.send`; frames are buffered until `flush`, so that those of one moment share a datagram."""
        del message
        if len(self._outgoing) + len(frame) > _PACKET_BYTES:
            self.flush()
        self._outgoing += frame

    def flush(self) -> None:
        """Write the buffered frames to the socket."""
        if self._outgoing:
            data, self._outgoing = self._outgoing, bytearray()
            self._write(data)

    @abstractmethod
    def _write(self, data: bytearray) -> None:
        """Write bytes to the socket."""

    def close(self) -> None:
        """Close the socket."""
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket.fileno())
            self._socket.close()

    @abstractmethod
    def _readable(self) -> None:
        """Read the available bytes of the socket."""

    def _feed(self, data: bytes) -> None:
        for message in self._parser.parse_buffer(data) or ():
            if message.get_type() != "BAD_DATA" and self.receiver is not None:
                self.receiver(message, bytes(message.get_msgbuf()))


class UdpLink(_SocketLink):
    """A UDP socket. Its peer is given, or learned from the datagrams that arrive."""

    def __init__(self, name: str, sock: socket.socket, remotes: Sequence[tuple[str, int]]) -> None:
        super().__init__(name, sock)
        self._learns = not remotes
        self._source: tuple[str, int] | None = None
        self._remotes = tuple(remotes)

    @staticmethod
    def sending_to(name: str, host: str, ports: Sequence[int]) -> UdpLink:
        """Send to ports of a host from any free port, as ArduPilot's SITL and PX4's do.

        Raises:
            LinkError: the host is unknown.
        """
        return UdpLink(name, _udp_socket(), [_resolve(host, port) for port in ports])

    @staticmethod
    def waiting_on(name: str, host: str, port: int) -> UdpLink:
        """Listen on `host:port` for a peer.

        Raises:
            LinkError: the port is in use or requires privileges.
        """
        sock = _udp_socket()
        try:
            sock.bind((host, port))
        except OSError as error:
            sock.close()
            raise _cannot_listen("UDP", host, port, error) from error
        return UdpLink(name, sock, ())

    def forward(self, frame: bytes) -> None:
        """Send a frame that has just been received to the other peers, as autopilots do."""
        self.flush()
        self._write(bytearray(frame), besides=self._source)

    def _write(self, data: bytearray, *, besides: tuple[str, int] | None = None) -> None:
        for remote in self._remotes:
            if remote == besides:
                continue
            try:
                self._socket.sendto(data, remote)
            except OSError:
                # nobody listens yet, or the buffer is full: datagrams may be lost
                self.lost += 1

    def _readable(self) -> None:
        while True:
            try:
                data, source = self._socket.recvfrom(_DATAGRAM_BYTES)
            except BlockingIOError:
                return
            except OSError:
                # the peer's "port unreachable" comes back as an error of the next call
                continue
            self._source = (source[0], source[1])
            if self._learns:
                self._remotes = (self._source,)
            self._feed(data)


class TcpLink(_SocketLink):
    """A TCP connection to an autopilot.

    Attributes:
        on_closed: called once when the peer has closed it.
    """

    def __init__(self, name: str, sock: socket.socket) -> None:
        super().__init__(name, sock)
        self.on_closed: Callable[[], None] | None = None

    @staticmethod
    async def connect(name: str, host: str, port: int, *, patience_s: float) -> TcpLink:
        """Connect, trying again for `patience_s` seconds.

        Raises:
            LinkError: no connection within that time.
        """
        loop = asyncio.get_running_loop()
        address = _resolve(host, port)
        deadline = loop.time() + patience_s
        while True:
            sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
            sock.setblocking(False)
            try:
                async with asyncio.timeout(max(0.1, deadline - loop.time())):
                    await loop.sock_connect(sock, address)
            except (OSError, TimeoutError) as error:
                sock.close()
                if loop.time() >= deadline:
                    raise LinkError(f"tcp:{host}:{port}: connection failed ({error or 'timed out'})") from error
                await asyncio.sleep(0.2)
            except BaseException:
                sock.close()
                raise
            else:
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                return TcpLink(name, sock)

    def _write(self, data: bytearray) -> None:
        # bytes that do not fit into the socket's buffer are dropped, as on a serial line
        with contextlib.suppress(OSError):
            self._socket.send(data)

    def _readable(self) -> None:
        try:
            data = self._socket.recv(_DATAGRAM_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._feed(data)
            return
        self.close()
        if self.on_closed is not None:
            self.on_closed()


def _udp_socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
    return sock


def _resolve(host: str, port: int) -> tuple[str, int]:
    try:
        found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise LinkError(f"{host}: no such host ({error.strerror or error})") from error
    return str(found[0][4][0]), port


def _cannot_listen(protocol: str, host: str, port: int, error: OSError) -> LinkError:
    if error.errno == errno.EADDRINUSE:
        return LinkError(f"{protocol} port {port} on {host} is in use by another program; choose another with --port")
    return LinkError(f"cannot listen on {protocol} port {port} of {host}: {error.strerror or error}")


async def attach(url: str, *, patience_s: float = 30.0) -> UdpLink | TcpLink:
    """Open the link that `--attach` names: `tcp:HOST:PORT`, `udpout:HOST:PORT` or `udpin:HOST:PORT` (`://` accepted).

    Raises:
        UsageError: invalid URL.
        LinkError: the link cannot be opened.
    """
    parts = urlsplit(url if "://" in url else url.replace(":", "://", 1))
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    scheme = {"tcpout": "tcp", "udp": "udpin"}.get(parts.scheme, parts.scheme)
    if host is None or port is None or scheme not in ("tcp", "udpout", "udpin"):
        raise UsageError(
            f"--attach {url}: expected tcp:HOST:PORT, udpout:HOST:PORT or udpin:HOST:PORT, like tcp:127.0.0.1:5762"
        )
    if scheme == "tcp":
        return await TcpLink.connect("autopilot", host, port, patience_s=patience_s)
    if scheme == "udpout":
        return UdpLink.sending_to("autopilot", host, [port])
    return UdpLink.waiting_on("autopilot", host, port)
