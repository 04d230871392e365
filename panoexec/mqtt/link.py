"""The connection to the broker: reconnects without limit, receives requests and publishes all other topics.

A mission never waits for the broker: messages are put into a bounded outbox and removed when the broker has
acknowledged them (QoS 1). A message can therefore be delivered twice, but it is not lost with a connection.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
import time
from collections.abc import AsyncIterator, Callable
from typing import Final

import aiomqtt
import structlog
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from panoexec.errors import PanoexecError
from panoexec.inputs.config import MqttSection
from panoexec.mqtt.certificates import explained
from panoexec.mqtt.client import CONNECT_S, BrokerClient, broker_client
from panoexec.mqtt.incoming import Inbox, Incoming, incoming_of
from panoexec.mqtt.outbox import Outbox, Outgoing, Suspicion
from panoexec.mqtt.topics import Topics, is_topic_part

ONLINE: Final = b"online"
OFFLINE: Final = b"offline"

BACKOFF_S: Final = 1.0
BACKOFF_MOST_S: Final = 30.0
_STEADY_S: Final = 10.0
_PULSE_S: Final = 2.0
_FAREWELL_S: Final = 1.0
_SESSION_EXPIRY_S: Final = 30
_INCOMING: Final = 500
_LARGEST_PACKET: Final = 16 * 2**20
_BATCH: Final = 16
_SUSPICIOUS: Final = 2
_REFUSED: Final = 128
_TAKEN_OVER: Final = 142
_AT_ONCE_S: Final = 3.0
_HEAD: Final = 100
"""Upper bound of the bytes of a packet without topic, payload and correlation data."""

_log = structlog.get_logger(__name__)


class MqttLink:
    """Keeps a connection to the broker; `run` it in a task.

    Attributes:
        topics: topics of the vehicle.
        connected: whether there is a connection.
        pulse_s: time.monotonic of the last progress of the task.
        reason: why there is no connection; "" if connected.
    """

    def __init__(
        self,
        settings: MqttSection,
        *,
        vehicle: str,
        on_request: Callable[[Incoming], None],
        on_connected: Callable[[], None] = lambda: None,
        backoff_s: float = BACKOFF_S,
    ) -> None:
        """Create the link.

        Args:
            settings: broker and credentials; `host` is set.
            vehicle: vehicle id.
            on_request: called with each request; must return immediately and not raise.
            on_connected: called at each connection, before anything is published.
            backoff_s: pause after the first failure, doubled up to `BACKOFF_MOST_S`.
        """
        self.topics = Topics(settings.prefix, vehicle)
        self.connected = False
        self.pulse_s = time.monotonic()
        self.reason = "not connected yet"
        self.outbox = Outbox()
        self._settings = settings
        self._vehicle = vehicle
        self._on_request = on_request
        self._on_connected = on_connected
        self._backoff_s = backoff_s
        self._five = settings.protocol == "5"
        self._times = 0
        self._stopping = asyncio.Event()
        self._said = ""
        self._short = 0
        self._suspicion = Suspicion()
        self._under_way: list[Outgoing] = []
        self._sent_s = -math.inf

    # --- publishing

    def publish(self, topic: str, payload: bytes, *, retain: bool = False, correlation: bytes | None = None) -> None:
        """Queue a message, which is published as soon as the broker is connected; never blocks."""
        self.outbox.put(Outgoing(topic=topic, payload=payload, retain=retain, correlation=correlation))

    def respond(self, request: Incoming, payload: bytes) -> None:
        """Publish a response on the response topic of the command, and on that of the request if it is allowed."""
        usual = self.topics.response(request.command if is_topic_part(request.command) else "unknown")
        self.publish(usual, payload, correlation=request.correlation)
        if not request.response_topic or request.response_topic == usual:
            return
        if self.topics.may_answer_at(request.response_topic):
            self.publish(request.response_topic, payload, correlation=request.correlation)
        else:
            _log.warning("response topic rejected", topic=request.response_topic[:200], allowed_below=self.topics.base)

    # --- connection

    def stop(self) -> None:
        """Let `run` end after publishing the queued messages, if connected, and `offline`."""
        self._stopping.set()
        self.outbox.filled.set()

    async def run(self) -> None:
        """Connect, and reconnect after every loss, until `stop`."""
        patience_s = self._backoff_s
        while not self._stopping.is_set():
            began = time.monotonic()
            try:
                await self._session()
            except (aiomqtt.MqttError, PanoexecError, OSError, TimeoutError, ValueError) as error:
                if time.monotonic() - began > _STEADY_S:
                    patience_s, self._short, self._said = self._backoff_s, 0, ""
                elif self.connected:
                    self._short += 1  # a broker disconnects a client when another one connects with the same client id
                self._lost(error)
                if self._blame(error):
                    patience_s = self._backoff_s
            finally:
                self.connected = False
            if self._stopping.is_set():
                return
            # jitter: the vehicles of a fleet must not all reconnect at the same time
            await self._pause(patience_s * random.uniform(0.5, 1.0))
            patience_s = min(2 * patience_s, BACKOFF_MOST_S)

    async def _pause(self, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while not self._stopping.is_set() and (left := deadline - time.monotonic()) > 0:
            self.pulse_s = time.monotonic()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(min(left, _PULSE_S)):
                    await self._stopping.wait()

    async def _session(self) -> None:
        """Run one connection until it ends."""
        client = await self._client()
        async with contextlib.AsyncExitStack() as stack:
            await self._until_stop(stack.enter_async_context(client))
            await self._subscribe(client)
            self._times += 1
            self.reason, self.connected = "", True
            _log.info("broker connected", host=self._settings.host, port=self._settings.port, topic=self.topics.base)
            await client.publish(self.topics.status, ONLINE, qos=1, retain=True)
            self.outbox.renew()
            self._on_connected()
            try:
                await self._talk(client)
            except aiomqtt.MqttError as error:
                raise _with_reason(client, error) from error
            except asyncio.CancelledError:
                # the client disconnects regularly, so the broker does not send the will
                with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
                    async with asyncio.timeout(_FAREWELL_S):
                        await client.publish(self.topics.status, OFFLINE, qos=1, retain=True)
                raise

    async def _until_stop(self, connecting: object) -> None:
        """Connect; a stop request interrupts the attempt."""
        task = asyncio.ensure_future(connecting)  # type: ignore[call-overload]  # any awaitable
        stop = asyncio.create_task(self._stopping.wait(), name="mqtt stop")
        try:
            await asyncio.wait({task, stop}, return_when=asyncio.FIRST_COMPLETED, timeout=2 * CONNECT_S)
            if not task.done():
                raise aiomqtt.MqttError("the broker does not respond")
            await task
        finally:
            self.pulse_s = time.monotonic()
            for one in (task, stop):
                one.cancel()
            await asyncio.gather(task, stop, return_exceptions=True)

    async def _talk(self, client: BrokerClient) -> None:
        """Receive requests and publish messages until the connection is lost or `stop`."""
        reading = asyncio.create_task(self._read(client), name="mqtt requests")
        sending = asyncio.create_task(self._send(client), name="mqtt outbox")
        try:
            await asyncio.wait({reading, sending}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (reading, sending):
                task.cancel()
            results = await asyncio.gather(reading, sending, return_exceptions=True)
        for result in results:
            if isinstance(result, Exception):
                raise result

    async def _read(self, client: aiomqtt.Client) -> None:
        inbox = client._queue  # noqa: SLF001
        assert isinstance(inbox, Inbox)
        async for message in client.messages:
            incoming = incoming_of(message, self.topics)
            if incoming is not None:
                self._on_request(incoming)
            await inbox.read_on()

    async def _send(self, client: BrokerClient) -> None:
        while True:
            self.pulse_s = time.monotonic()
            # yield, so that an event and the state that it changes are sent in one batch
            await asyncio.sleep(0)
            batch = self._next(client)
            if batch:
                await self._send_batch(client, batch)
            elif self._stopping.is_set():
                await client.publish(self.topics.status, OFFLINE, qos=1, retain=True)
                return
            else:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_PULSE_S):
                        await self.outbox.filled.wait()

    def _next(self, client: BrokerClient) -> list[Outgoing]:
        """The next batch that the broker accepts; messages above its maximum packet size are dropped."""
        while True:
            batch = self.outbox.take(1 if self._suspicion.wary else min(_BATCH, client.most_unacknowledged))
            most = client.largest_packet
            large = [message for message in batch if most is not None and _size(message) > most]
            if not large:
                return batch
            for message in large:
                self._give_up(message, f"exceeds the broker's maximum packet size of {most} bytes")

    async def _send_batch(self, client: aiomqtt.Client, batch: list[Outgoing]) -> None:
        """Send several messages at once, in order, to avoid a round trip per message on slow radio links."""
        self._under_way, self._sent_s = list(batch), time.monotonic()
        sends = [
            asyncio.ensure_future(
                client.publish(
                    message.topic, message.payload, qos=1, retain=message.retain, properties=self._properties(message)
                )
            )
            for message in batch
        ]
        try:
            results = await asyncio.gather(*sends, return_exceptions=True)
        finally:
            for send in sends:
                send.cancel()
        for message, result in zip(batch, results, strict=True):
            if isinstance(result, BaseException):
                raise result
            self.outbox.done(message)
            self._under_way.remove(message)
        self._suspicion.acknowledged(batch, left=len(self.outbox))

    def _blame(self, error: Exception) -> bool:
        """Whether an unacknowledged message may have ended the connection; it is dropped after repeated failures."""
        waiting, self._under_way = self._under_way, []
        taken_over = getattr(getattr(error, "rc", None), "value", None) == _TAKEN_OVER
        if not waiting or taken_over or time.monotonic() - self._sent_s > _AT_ONCE_S:
            return False
        if self._suspicion.ended(waiting[0], alone=len(waiting) == 1):
            self._give_up(waiting[0], f"the broker closes the connection when it is sent ({error})")
        return True

    def _give_up(self, message: Outgoing, why: str) -> None:
        _log.error(
            "message dropped: rejected by the broker", topic=message.topic[:200], size=len(message.payload), error=why
        )
        self.outbox.give_up(message)

    # --- protocol details

    async def _client(self) -> BrokerClient:
        connect = None
        if self._five:
            connect = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            # requests sent during a short loss of the connection are delivered afterwards, unless they expire
            connect.SessionExpiryInterval = _SESSION_EXPIRY_S
            connect.MaximumPacketSize = _LARGEST_PACKET
        return await broker_client(
            self._settings,
            identifier=f"panoexec-{self.topics.base.replace('/', '-')}",
            connect=connect,
            # discard requests that were sent before this process started
            clean_start=self._times == 0 if self._five else 3,
            clean_session=None if self._five else True,
            will=aiomqtt.Will(self.topics.status, OFFLINE, qos=1, retain=True),
            queue_type=Inbox,
            max_queued_incoming_messages=_INCOMING,
            max_inflight_messages=_BATCH + 4,
        )

    async def _subscribe(self, client: aiomqtt.Client) -> None:
        if self._five:
            # with retainAsPublished the retain flag of live requests is visible, so that they can be rejected
            options = SubscribeOptions(qos=1, retainAsPublished=True, retainHandling=0)
            answer = await client.subscribe(self.topics.requests, options=options)
        else:
            answer = await client.subscribe(self.topics.requests, qos=1)
        code = answer[0]
        if getattr(code, "value", code) >= _REFUSED:
            raise aiomqtt.MqttError(
                f"not permitted to subscribe to {self.topics.requests}: check the ACL of the broker"
            )

    def _properties(self, message: Outgoing) -> Properties | None:
        if not self._five:
            return None
        properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        if message.payload:
            properties.ContentType = "application/json"
            properties.PayloadFormatIndicator = 1
        if message.correlation is not None:
            properties.CorrelationData = message.correlation
        return properties

    def _lost(self, error: Exception) -> None:
        text = explained(str(error) or type(error).__name__, self._settings)
        if self._short >= _SUSPICIOUS and not self._suspicion.wary:
            text = (
                f"connections end immediately: check whether two daemons use the vehicle id {self._vehicle!r} ({text})"
            )
        self.reason = text
        if text != self._said:
            _log.warning(
                "broker connection failed, retrying", host=self._settings.host, port=self._settings.port, error=text
            )
        self._said = text


def _with_reason(client: aiomqtt.Client, error: aiomqtt.MqttError) -> aiomqtt.MqttError:
    """The error with the reason code of the disconnection, which aiomqtt does not expose."""
    ended = client._disconnected  # noqa: SLF001
    reason = ended.exception() if ended.done() and not ended.cancelled() else None
    return reason if isinstance(reason, aiomqtt.MqttError) else error


def _size(message: Outgoing) -> int:
    return len(message.payload) + len(message.topic.encode()) + len(message.correlation or b"") + _HEAD


@contextlib.asynccontextmanager
async def running(link: MqttLink) -> AsyncIterator[MqttLink]:
    """Run the link during the block; publish `offline` at its end."""
    async with asyncio.TaskGroup() as group:
        group.create_task(link.run(), name="mqtt link")
        try:
            yield link
        finally:
            link.stop()
