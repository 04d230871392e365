"""A TCP proxy before a broker: a slow radio link, or a broker with other manners.

It reads MQTT packets in both directions, so that a test can change what a broker announces, or close the connection at
a certain packet, as brokers do that are not installed here.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

CONNECT, CONNACK, PUBLISH = 1, 2, 3
_PIECE_S = 0.02


@dataclass(slots=True)
class BrokerProxy:
    """Set before a connection is made.

    Attributes:
        port: where it listens.
        target: port of the broker for the next connection.
        rate: bytes per second in each direction; 0 for as fast as possible.
        edit: changes a packet of the broker, from its first byte, and its content after the length.
        closes_at: whether to close the connection at a packet of a client, from the same.
        answers_connect: sent in place of the broker's CONNACK, before the connection is closed.
        connections: number of connections.
        carried: bytes from clients to the broker.
    """

    port: int = 0
    target: int = 0
    rate: float = 0.0
    edit: Callable[[int, bytes], bytes] = lambda _first, content: content
    closes_at: Callable[[int, bytes], bool] = lambda _first, _content: False
    answers_connect: bytes | None = None
    connections: int = 0
    carried: int = 0
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)


@asynccontextmanager
async def broker_proxy(broker_port: int, **settings: object) -> AsyncIterator[BrokerProxy]:
    """A proxy while the block runs."""
    proxy = BrokerProxy(target=broker_port, **settings)  # type: ignore[arg-type]  # a test's keywords

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        proxy.connections += 1
        task = asyncio.current_task()
        assert task is not None
        proxy._tasks.add(task)
        with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
            await _carry(proxy, reader, writer)
        await _closed(writer)
        proxy._tasks.discard(task)

    # small buffers: what the radio has not carried must not look as if it had left
    server = await asyncio.start_server(serve, "127.0.0.1", 0, limit=2048)
    proxy.port = server.sockets[0].getsockname()[1]
    try:
        yield proxy
    finally:
        server.close()
        for task in list(proxy._tasks):
            task.cancel()
        await asyncio.gather(*proxy._tasks, return_exceptions=True)
        for _ in range(3):  # the transports close in the next turns of the loop
            await asyncio.sleep(0)


async def _carry(proxy: BrokerProxy, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    from_broker, to_broker = await asyncio.open_connection("127.0.0.1", proxy.target)
    up = asyncio.create_task(_up(proxy, reader, to_broker, writer), name="proxy up")
    down = asyncio.create_task(_down(proxy, from_broker, writer), name="proxy down")
    try:
        await asyncio.wait({up, down}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        to_broker.close()  # first: this task may be cancelled meanwhile
        for task in (up, down):
            task.cancel()
        await asyncio.gather(up, down, return_exceptions=True)
        await _closed(to_broker)


async def _closed(writer: asyncio.StreamWriter) -> None:
    writer.close()
    with contextlib.suppress(OSError, asyncio.CancelledError):
        await writer.wait_closed()


async def _up(
    proxy: BrokerProxy, reader: asyncio.StreamReader, to_broker: asyncio.StreamWriter, back: asyncio.StreamWriter
) -> None:
    while True:
        first, length, content = await _packet(proxy, reader)
        if first >> 4 == CONNECT and proxy.answers_connect is not None:
            back.write(proxy.answers_connect)
            await back.drain()
            return
        if proxy.closes_at(first, content):
            return
        packet = bytes([first]) + length + content
        proxy.carried += len(packet)
        to_broker.write(packet)
        await to_broker.drain()


async def _down(proxy: BrokerProxy, from_broker: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while True:
        first, _, content = await _packet(None, from_broker)
        content = proxy.edit(first, content)
        packet = bytes([first]) + varint(len(content)) + content
        writer.write(packet)
        await writer.drain()
        if proxy.rate:
            await asyncio.sleep(len(packet) / proxy.rate)


async def _packet(slow: BrokerProxy | None, reader: asyncio.StreamReader) -> tuple[int, bytes, bytes]:
    """First byte, encoded length, content; read at the rate of the link."""
    first = (await reader.readexactly(1))[0]
    length, value, shift = b"", 0, 0
    while True:
        byte = await reader.readexactly(1)
        length += byte
        value |= (byte[0] & 0x7F) << shift
        shift += 7
        if not byte[0] & 0x80:
            break
    if slow is None or not slow.rate:
        return first, length, await reader.readexactly(value)
    content = b""
    loop = asyncio.get_running_loop()
    due = loop.time() + (1 + len(length)) / slow.rate
    while len(content) < value:
        piece = await reader.readexactly(min(value - len(content), max(1, int(slow.rate * _PIECE_S))))
        content += piece
        due += len(piece) / slow.rate
        await asyncio.sleep(max(0.0, due - loop.time()))
    return first, length, content


def varint(value: int) -> bytes:
    out = b""
    while True:
        value, digit = value >> 7, value & 0x7F
        out += bytes([digit | (0x80 if value else 0)])
        if not value:
            return out


def announcing(*properties: bytes) -> Callable[[int, bytes], bytes]:
    """An `edit` that adds properties to CONNACK (MQTT 5)."""

    def edit(first: int, content: bytes) -> bytes:
        if first >> 4 != CONNACK:
            return content
        flags_and_reason, known = content[:2], content[3:]  # fewer than 128 bytes of properties
        added = known + b"".join(properties)
        return flags_and_reason + varint(len(added)) + added

    return edit


def is_retained_publish(first: int, _content: bytes) -> bool:
    """Whether a client's packet is PUBLISH with the retain flag."""
    return first >> 4 == PUBLISH and bool(first & 1)
