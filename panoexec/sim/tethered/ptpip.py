"""PTP/IP (CIPA DC-005): a camera's two TCP connections, for operations and for events, on one port."""

from __future__ import annotations

import asyncio
import contextlib
import struct
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Final

from panoexec.errors import LinkError
from panoexec.sim.tethered.responder import Responder

_GUID: Final = b"panoexec-sim-cam"
_VERSION: Final = 0x00010000
_DATA_OUT: Final = 2
_MOST: Final = 1 << 20
_CHUNK: Final = 1 << 18


class Packet(IntEnum):
    """Types of packets."""

    INIT_COMMAND = 1
    INIT_COMMAND_ACK = 2
    INIT_EVENT = 3
    INIT_EVENT_ACK = 4
    INIT_FAIL = 5
    OPERATION = 6
    RESPONSE = 7
    EVENT = 8
    START_DATA = 9
    DATA = 10
    CANCEL = 11
    END_DATA = 12
    PING = 13
    PONG = 14


class PtpIpServer:
    """Serves one camera on one port; one client at a time, as cameras do.

    Attributes:
        responder: the camera.
        on_operation: called with the code of each operation before it is carried out.
        stalled: while it is cleared, nothing is answered.
    """

    def __init__(self, responder: Responder, *, on_operation: Callable[[int], None] = lambda _: None) -> None:
        self.responder = responder
        self.on_operation = on_operation
        self.stalled = asyncio.Event()
        self.stalled.set()
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()
        self._events: asyncio.StreamWriter | None = None
        self._connections = 0

    async def start(self, host: str, port: int) -> int:
        """Listen; returns the port.

        Raises:
            LinkError: the port is in use.
        """
        try:
            self._server = await asyncio.start_server(self._accepted, host, port)
        except OSError as error:
            raise LinkError(f"{host}:{port}: the simulated camera cannot listen there ({error.strerror})") from error
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Close everything."""
        if self._server is not None:
            self._server.close()
        self.unplug()
        if self._server is not None:
            await self._server.wait_closed()

    def unplug(self) -> None:
        """Cut all connections, as a pulled cable or a camera that is switched off does."""
        self._events = None
        for writer in tuple(self._writers):
            writer.transport.abort()

    def tell(self, code: int, *params: int) -> None:
        """Send an event to whoever is connected; nobody hears it otherwise."""
        if self._events is not None and not self._events.is_closing():
            self._events.write(_packet(Packet.EVENT, struct.pack("<HIIII", code, 0, *(*params, 0, 0, 0)[:3])))

    async def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        # a camera that is switched off cuts the connection; what a client sends wrongly ends it
        with contextlib.suppress(OSError, asyncio.IncompleteReadError, struct.error, ValueError):
            kind, _ = await _read(reader)
            if kind == Packet.INIT_COMMAND:
                self._connections += 1
                name = self.responder.model.encode("utf-16-le") + b"\0\0"
                ack = struct.pack("<I", self._connections) + _GUID + name + struct.pack("<I", _VERSION)
                writer.write(_packet(Packet.INIT_COMMAND_ACK, ack))
                await self._serve(reader, writer)
            elif kind == Packet.INIT_EVENT:
                writer.write(_packet(Packet.INIT_EVENT_ACK, b""))
                self._events = writer
                while True:
                    kind, _ = await _read(reader)
                    if kind == Packet.PING:
                        writer.write(_packet(Packet.PONG, b""))
            else:
                writer.write(_packet(Packet.INIT_FAIL, struct.pack("<I", 1)))
        if self._events is writer:
            self._events = None
        self._writers.discard(writer)
        writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Operations, one after the other."""
        while True:
            kind, body = await _read(reader)
            if kind == Packet.PING:
                writer.write(_packet(Packet.PONG, b""))
            if kind != Packet.OPERATION:
                continue
            phase, code, transaction = struct.unpack_from("<IHI", body)
            params = struct.unpack_from(f"<{(len(body) - 10) // 4}I", body, 10)
            data = await _sent(reader) if phase == _DATA_OUT else b""
            self.on_operation(code)
            await self.stalled.wait()
            result, content = self.responder.answer(code, params, data)
            if content is not None:
                _write_data(writer, transaction, content)
            writer.write(_packet(Packet.RESPONSE, struct.pack("<HI", result, transaction)))
            await writer.drain()


def _write_data(writer: asyncio.StreamWriter, transaction: int, content: bytes) -> None:
    writer.write(_packet(Packet.START_DATA, struct.pack("<IQ", transaction, len(content))))
    starts: Sequence[int] = range(0, len(content), _CHUNK) or (0,)
    for start in starts:
        last = start + _CHUNK >= len(content)
        kind = Packet.END_DATA if last else Packet.DATA
        writer.write(_packet(kind, struct.pack("<I", transaction) + content[start : start + _CHUNK]))


async def _sent(reader: asyncio.StreamReader) -> bytes:
    """The data that a client sends with an operation."""
    parts = []
    while True:
        kind, body = await _read(reader)
        if kind in {Packet.DATA, Packet.END_DATA}:
            parts.append(body[4:])
        if kind in {Packet.END_DATA, Packet.CANCEL}:
            return b"".join(parts)


async def _read(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    length, kind = struct.unpack("<II", await reader.readexactly(8))
    if not 8 <= length <= _MOST:
        raise ValueError(f"a packet of {length} bytes")
    return kind, await reader.readexactly(length - 8)


def _packet(kind: int, body: bytes) -> bytes:
    return struct.pack("<II", len(body) + 8, kind) + body
