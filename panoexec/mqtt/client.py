"""The MQTT client: fails immediately with a reason, closes its socket, and reports acknowledgements."""

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
"""Available on Linux only."""

_log = structlog.get_logger(__name__)


class BrokerClient(aiomqtt.Client):
    """An aiomqtt client that also exposes protocol details.

    Attributes:
        acknowledged: reason code (MQTT 5) of the last acknowledged message; 128 and above are rejections.
        most_unacknowledged: receive maximum of the broker: number of unacknowledged messages (MQTT 5).
        largest_packet: maximum packet size of the broker in bytes (MQTT 5), None if it does not announce one.
    """

    def __init__(self, **options: Any) -> None:
        """Create a client with the options of aiomqtt's client."""
        self.acknowledged = 0
        self.most_unacknowledged = 65_535
        self.largest_packet: int | None = None
        self._trouble = _Trouble()
        self._abandoned = False
        logger = logging.Logger("mqtt")  # noqa: LOG001  (a logger per connection)
        logger.addHandler(self._trouble)
        logger.setLevel(self._trouble.level)  # paho logs every packet at debug level
        super().__init__(**options, logger=logger)

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

    # --- callbacks of paho

    def _on_disconnect(self, client: Any, userdata: Any, flags: Any, reason_code: Any, properties: Any = None) -> None:
        # without this, a broker that closes the connection (TLS 1.3 client certificate rejected) runs into the timeout
        if not self._connected.done():
            self._connected.set_exception(aiomqtt.MqttError(self._trouble.last or f"{reason_code}"))
            self._connected.exception()  # mark the exception as retrieved, the waiter may be gone
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
        if self._abandoned:  # connected in its thread after the cancellation
            sock.close()
            return
        super()._on_socket_open(client, userdata, sock)

    def _acknowledge_at_once(self) -> None:
        """Send the TCP acknowledgement of the received data immediately.

        A broker with Nagle's algorithm (mosquitto's default) delays the next small packet until the previous one is
        acknowledged. The kernel delays this acknowledgement by 40 ms if there is no data to send.
        """
        sock = self._client.socket()
        if _QUICK_ACK is not None and isinstance(sock, socket.socket):
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.IPPROTO_TCP, _QUICK_ACK, 1)


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
