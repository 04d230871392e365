"""The one client of the broker: fails at once and says why, leaves no socket behind, tells what was acknowledged."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import uuid
from typing import Any, Final, Self

import aiomqtt
import structlog
from paho.mqtt.properties import Properties

from panoexec.inputs.config import MqttSection
from panoexec.mqtt.certificates import check_dates
from panoexec.mqtt.credentials import read_password, tls_context

CONNECT_S: Final = 10.0
_QUICK_ACK: Final[int | None] = getattr(socket, "TCP_QUICKACK", None)
"""Linux has it."""

_log = structlog.get_logger(__name__)


class BrokerClient(aiomqtt.Client):
    """An aiomqtt client with what that keeps to itself.

    Attributes:
        acknowledged: MQTT 5's reason code of the last acknowledged message; 128 and above are refusals.
        most_unacknowledged: messages that the broker takes before it has acknowledged the first (MQTT 5).
        largest_packet: bytes of a packet that it takes at most (MQTT 5), None if it does not say.
    """

    def __init__(self, **options: Any) -> None:
        """As aiomqtt's."""
        self.acknowledged = 0
        self.most_unacknowledged = 65_535
        self.largest_packet: int | None = None
        self._trouble = _Trouble()
        self._abandoned = False
        logger = logging.Logger("mqtt")  # noqa: LOG001  (not the library's: what it says belongs to this connection)
        logger.addHandler(self._trouble)
        logger.setLevel(self._trouble.level)  # paho remarks on each packet
        super().__init__(**options, logger=logger)

    async def __aenter__(self) -> Self:
        """Connect; a connection that does not come about leaves nothing open.

        Raises:
            aiomqtt.MqttError: it did not.
        """
        try:
            return await super().__aenter__()
        except BaseException:
            self._abandoned = True
            self._client._sock_close()  # noqa: SLF001
            raise

    # --- called by paho

    def _on_disconnect(self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None) -> None:
        # a broker that hangs up instead of answering (TLS 1.3 refuses our certificate so) would be waited for in vain
        if not self._connected.done():
            self._connected.set_exception(aiomqtt.MqttError(self._trouble.last or f"{reason_code}"))
            self._connected.exception()  # somebody who stopped waiting need not be told
            return
        super()._on_disconnect(client, userdata, flags, reason_code, properties)

    def _on_connect(self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None) -> None:
        self.most_unacknowledged = int(getattr(properties, "ReceiveMaximum", self.most_unacknowledged))
        self.largest_packet = getattr(properties, "MaximumPacketSize", None)
        super()._on_connect(client, userdata, flags, reason_code, properties)

    def _on_publish(self, client: Any, userdata: Any, mid: int, reason_code: Any, properties: Any) -> None:
        self.acknowledged = int(getattr(reason_code, "value", 0))
        self._acknowledge_at_once()
        super()._on_publish(client, userdata, mid, reason_code, properties)

    def _on_socket_open(self, client: Any, userdata: Any, sock: Any) -> None:
        if self._abandoned:  # it connected in its thread after we were cancelled
            sock.close()
            return
        super()._on_socket_open(client, userdata, sock)

    def _acknowledge_at_once(self) -> None:
        """Send TCP's acknowledgement of what was just read.

        A broker that collects small packets (Nagle; mosquitto's default) holds the next message back until the one
        before is acknowledged, which the kernel does only after 40 ms when we have nothing to say ourselves.
        """
        sock = self._client.socket()
        if _QUICK_ACK is not None and isinstance(sock, socket.socket):
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.IPPROTO_TCP, _QUICK_ACK, 1)


class _Trouble(logging.Handler):
    """Keeps the last error that the library would only print."""

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
    """A client as the settings say; entering it connects.

    Args:
        settings: broker and how to speak to it; `host` is set.
        identifier: of the client; a random one, beginning with the given text, if that ends in a hyphen.
        connect: properties of the connection (MQTT 5).
        **options: of aiomqtt's client.

    Raises:
        UsageError: a password or certificate file is wrong, or our certificate has expired.
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
        # small packets must not wait for the acknowledgement of the one before (40 ms each)
        socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
        **options,
    )
