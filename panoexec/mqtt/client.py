"""The MQTT client: fails immediately with a reason, closes its socket, and reports acknowledgements."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import threading
import uuid
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Final, Self, TypeVar

import aiomqtt
import structlog
from paho.mqtt.client import MQTT_ERR_SUCCESS
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.certificates import check_dates
from panoexec.mqtt.credentials import read_password, tls_context

T = TypeVar("T")

CONNECT_S: Final = 10.0
REFUSED: Final = 128
"""Reason codes from here on are refusals."""

_QUICK_ACK: Final[int | None] = getattr(socket, "TCP_QUICKACK", None)
"""Available on Linux only."""

_log = structlog.get_logger(__name__)


class ConnectionClosedError(aiomqtt.MqttError):
    """The broker closed the connection before it answered CONNECT, and gave no reason."""

    def __init__(self) -> None:
        super().__init__("the broker closed the connection at CONNECT, without a reason")


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerLimits:
    """What the broker announced at the connection (CONNACK properties of MQTT 5); the defaults without.

    Attributes:
        most_unacknowledged: receive maximum: number of unacknowledged messages.
        largest_packet: maximum packet size in bytes; None for no limit.
        retain: whether it keeps retained messages (Retain Available).
        max_qos: the highest quality of service (Maximum QoS).
        wildcards: whether it accepts wildcards in subscriptions.
    """

    most_unacknowledged: int = 65_535
    largest_packet: int | None = None
    retain: bool = True
    max_qos: int = 2
    wildcards: bool = True


class _Registering:
    """The event loop as aiomqtt uses it: of a socket that was closed before the loop came to it, nothing is registered.

    aiomqtt lets the loop register a socket in its next turn; paho may close it before, and tells that failure itself.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop

    def call_soon_threadsafe(self, call: Callable[..., object], *arguments: Any) -> asyncio.Handle:
        def unless_closed() -> None:
            with contextlib.suppress(OSError, ValueError):
                call(*arguments)

        return self._loop.call_soon_threadsafe(unless_closed)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loop, name)


class BrokerClient(aiomqtt.Client):
    """An aiomqtt client that also exposes protocol details.

    Attributes:
        limits: what the broker announced at the connection.
        session_present: whether it still had the session of this client id.
    """

    def __init__(self, **options: Any) -> None:
        """Create a client with the options of aiomqtt's client."""
        self.limits = BrokerLimits()
        self.session_present = False
        self._codes: dict[int, int] = {}
        self._trouble = _Trouble()
        self._abandoned = False
        self._loop_thread = threading.get_ident()
        logger = logging.Logger("mqtt")  # noqa: LOG001  (a logger per connection)
        logger.addHandler(self._trouble)
        logger.setLevel(self._trouble.level)  # paho logs every packet at debug level
        super().__init__(**options, logger=logger)
        self._loop: Any = _Registering(self._loop)

    async def __aenter__(self) -> Self:
        """Connect; a failed connection leaves no socket open.

        Raises:
            aiomqtt.MqttError: the connection failed.
        """
        try:
            return await super().__aenter__()
        except BaseException:
            self._abandoned = True
            self._client._sock_close()  # noqa: SLF001
            raise

    @property
    def is_lost(self) -> bool:
        """Whether the connection has ended."""
        return self._disconnected.done()

    # --- publishing

    async def send(
        self,
        topic: str,
        payload: bytes,
        *,
        qos: int,
        retain: bool,
        properties: Properties | None = None,
        timeout_s: float = CONNECT_S,
    ) -> int:
        """Publish, and return the reason code of the acknowledgement: 128 and above are refusals.

        A code of 0 means success, or that the broker does not tell: with QoS 0, or with MQTT 3.1.1.

        Raises:
            aiomqtt.MqttError: the connection is lost, or there was no acknowledgement in time.
        """
        info = self._client.publish(topic, payload, qos, retain, properties)
        if info.rc != MQTT_ERR_SUCCESS:
            raise aiomqtt.MqttCodeError(info.rc, "Could not publish message")
        if not info.is_published():
            confirmation = asyncio.Event()
            with self._pending_call(info.mid, confirmation, self._pending_publishes):
                await self._unless_lost(confirmation.wait(), timeout_s)
        return self._codes.pop(info.mid, 0)

    async def may_publish(self, topic: str) -> bool:
        """Ask whether publishing to this topic is permitted, without a message to any subscriber (MQTT 5).

        With QoS 2 the broker answers PUBLISH with its verdict and delivers at PUBREL, which is never sent here. The
        payload is empty, should a broker deliver earlier. Only for a client that ends without a session.

        Raises:
            aiomqtt.MqttError: the connection is lost, or there was no answer in time.
        """
        verdict: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        paho: Any = self._client

        def at_pubrec() -> int:
            packet = paho._in_packet["packet"]  # noqa: SLF001
            if not verdict.done():
                verdict.set_result(packet[2] if len(packet) > 2 else 0)
            return int(MQTT_ERR_SUCCESS)

        paho._handle_pubrec = at_pubrec  # noqa: SLF001
        info = self._client.publish(topic, b"", 2, False)
        if info.rc != MQTT_ERR_SUCCESS:
            raise aiomqtt.MqttCodeError(info.rc, "Could not publish message")
        await self._unless_lost(verdict, CONNECT_S)
        return verdict.result() < REFUSED

    async def ask_for(self, topic: str, *, qos: int = 0, options: SubscribeOptions | None = None) -> int:
        """Subscribe, and return the reason code: 128 and above are refusals.

        Raises:
            aiomqtt.MqttError: the connection is lost, or there was no answer in time.
        """
        code: Any = (await self._unless_lost(self.subscribe(topic, qos=qos, options=options), CONNECT_S))[0]
        return int(getattr(code, "value", code))

    async def _unless_lost(self, work: Awaitable[T], timeout_s: float) -> T:
        """Wait for something that the broker will tell, at once no longer when the connection is lost."""
        task = asyncio.ensure_future(work)
        ends: set[asyncio.Future[Any]] = {task, self._disconnected}
        try:
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED, timeout=timeout_s)
            if task.done():
                return task.result()
            if not self._disconnected.done():
                raise aiomqtt.MqttError("Operation timed out")
            lost = self._disconnected.exception()
            raise lost if isinstance(lost, aiomqtt.MqttError) else aiomqtt.MqttError("the connection is lost")
        finally:
            task.cancel()

    # --- callbacks of paho

    def _on_disconnect(self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None) -> None:
        # without this, a broker that closes the connection (TLS 1.3 client certificate rejected) runs into the timeout
        if not self._connected.done():
            told = self._trouble.last
            self._connected.set_exception(aiomqtt.MqttError(told) if told else ConnectionClosedError())
            self._connected.exception()  # mark the exception as retrieved, the waiter may be gone
            return
        super()._on_disconnect(client, userdata, flags, reason_code, properties)

    def _on_connect(self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None) -> None:
        self.limits = _limits(properties)
        self.session_present = bool(getattr(flags, "session_present", False))
        super()._on_connect(client, userdata, flags, reason_code, properties)

    def _on_publish(self, client: Any, userdata: Any, mid: int, reason_code: Any, properties: Any) -> None:
        code = int(getattr(reason_code, "value", 0))
        if code >= REFUSED:
            self._codes[mid] = code
        self._acknowledge_at_once()
        super()._on_publish(client, userdata, mid, reason_code, properties)

    def _on_socket_open(self, client: Any, userdata: Any, sock: Any) -> None:
        self._unless_abandoned(super()._on_socket_open, client, userdata, sock)

    def _on_socket_register_write(self, client: Any, userdata: Any, sock: Any) -> None:
        self._unless_abandoned(super()._on_socket_register_write, client, userdata, sock)

    def _unless_abandoned(self, register: Callable[..., None], client: Any, userdata: Any, sock: Any) -> None:
        """Register a socket with the loop, in the loop's thread: the one that connects may go on after a cancellation.

        The loop would then be given a descriptor that is closed, or belongs to something else.
        """

        def here() -> None:
            if self._abandoned:
                sock.close()
            elif sock.fileno() >= 0:
                register(client, userdata, sock)

        if threading.get_ident() == self._loop_thread:
            here()
        else:
            self._loop.call_soon_threadsafe(here)

    def _acknowledge_at_once(self) -> None:
        """Send the TCP acknowledgement of the received data immediately.

        A broker with Nagle's algorithm (mosquitto's default) delays the next small packet until the previous one is
        acknowledged. The kernel delays this acknowledgement by 40 ms if there is no data to send.
        """
        sock = self._client.socket()
        if _QUICK_ACK is not None and isinstance(sock, socket.socket):
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.IPPROTO_TCP, _QUICK_ACK, 1)


def _limits(properties: Any) -> BrokerLimits:
    usual = BrokerLimits()

    def announced(name: str, default: Any) -> Any:
        return getattr(properties, name, default)

    return BrokerLimits(
        most_unacknowledged=int(announced("ReceiveMaximum", usual.most_unacknowledged)),
        largest_packet=announced("MaximumPacketSize", None),
        retain=bool(announced("RetainAvailable", 1)),
        max_qos=int(announced("MaximumQoS", usual.max_qos)),
        wildcards=bool(announced("WildcardSubscriptionAvailable", 1)),
    )


class _Trouble(logging.Handler):
    """Keeps the last error that the library only logs."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.last = ""

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if record.levelno >= logging.ERROR:
            self.last = text
        _log.debug("mqtt library", text=text)


async def broker_client(
    settings: MqttSection, *, identifier: str = "", connect: Properties | None = None, **options: Any
) -> BrokerClient:
    """Create a client from the settings; entering the context connects it.

    Args:
        settings: broker and credentials; `host` is set.
        identifier: client id; if it ends with a hyphen, a random suffix is appended.
        connect: properties of the CONNECT packet (MQTT 5).
        **options: options of aiomqtt's client.

    Raises:
        UsageError: a password or certificate file is invalid, or the client certificate has expired.
    """
    assert settings.host is not None
    password = await asyncio.to_thread(read_password, settings)
    tls = await asyncio.to_thread(tls_context, settings)
    await asyncio.to_thread(check_dates, settings)
    if identifier.endswith("-"):
        identifier += f"{os.getpid()}-{uuid.uuid4().hex[:8]}"
    return BrokerClient(
        hostname=settings.host,
        port=settings.port,
        username=settings.username,
        password=password,
        identifier=identifier,
        protocol=aiomqtt.ProtocolVersion.V5 if settings.protocol == "5" else aiomqtt.ProtocolVersion.V311,
        properties=connect,
        keepalive=settings.keepalive_s,
        timeout=CONNECT_S,
        tls_context=tls,
        # disable Nagle's algorithm, which delays small packets by up to 40 ms each
        socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
        **options,
    )
