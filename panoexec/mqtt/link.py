"""The connection to the broker: opened again for ever, with a will, requests in, everything else out.

Nothing here waits for the broker on behalf of a mission: what is published goes into a bounded outbox and leaves it
when the broker has acknowledged it (QoS 1), so a message may come twice but is not lost with a connection.
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
"""Bytes of a packet besides topic, payload and correlation data."""

_log = structlog.get_logger(__name__)


class MqttLink:
    """Keeps a connection to the broker; `run` it in a task.

    Attributes:
        topics: of the vehicle.
        connected: whether the broker answers.
        pulse_s: time.monotonic when the link last proved that it is not stuck.
        reason: why there is no connection, "" if there is one.
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
        """Describe the link.

        Args:
            settings: broker and how to speak to it; `host` is set.
            vehicle: its id.
            on_request: takes each request, at once; must not raise.
            on_connected: called at each connection, before anything is published.
            backoff_s: wait after the first failure, doubled up to `BACKOFF_MOST_S`.
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

    # --- out

    def publish(self, topic: str, payload: bytes, *, retain: bool = False, correlation: bytes | None = None) -> None:
        """Publish as soon as the broker is there; never waits."""
        self.outbox.put(Outgoing(topic=topic, payload=payload, retain=retain, correlation=correlation))

    def respond(self, request: Incoming, payload: bytes) -> None:
        """Answer a request: on the command's response topic, and where its sender wants it, if that is allowed."""
        usual = self.topics.response(request.command if is_topic_part(request.command) else "unknown")
        self.publish(usual, payload, correlation=request.correlation)
        if not request.response_topic or request.response_topic == usual:
            return
        if self.topics.may_answer_at(request.response_topic):
            self.publish(request.response_topic, payload, correlation=request.correlation)
        else:
            _log.warning("response topic refused", topic=request.response_topic[:200], allowed_below=self.topics.base)

    # --- life

    def stop(self) -> None:
        """Let `run` end: what waits is published if the broker is there, then `offline`."""
        self._stopping.set()
        self.outbox.filled.set()

    async def run(self) -> None:
        """Connect, and again after every loss, until `stop`."""
        patience_s = self._backoff_s
        while not self._stopping.is_set():
            began = time.monotonic()
            try:
                await self._session()
            except (aiomqtt.MqttError, PanoexecError, OSError, TimeoutError, ValueError) as error:
                if time.monotonic() - began > _STEADY_S:
                    patience_s, self._short, self._said = self._backoff_s, 0, ""
                elif self.connected:
                    self._short += 1  # a broker ends the connection of a client when a second one comes with its name
                self._lost(error)
                if self._blame(error):
                    patience_s = self._backoff_s
            finally:
                self.connected = False
            if self._stopping.is_set():
                return
            # full jitter: a fleet whose broker comes back does not come back at once
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
        """One connection, from its beginning to its end."""
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
                # the client says goodbye to the broker, which then keeps the will to itself
                with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
                    async with asyncio.timeout(_FAREWELL_S):
                        await client.publish(self.topics.status, OFFLINE, qos=1, retain=True)
                raise

    async def _until_stop(self, connecting: object) -> None:
        """Connect, but do not keep a stop waiting."""
        task = asyncio.ensure_future(connecting)  # type: ignore[call-overload]  # any awaitable
        stop = asyncio.create_task(self._stopping.wait(), name="mqtt stop")
        try:
            await asyncio.wait({task, stop}, return_when=asyncio.FIRST_COMPLETED, timeout=2 * CONNECT_S)
            if not task.done():
                raise aiomqtt.MqttError("the broker does not answer")
            await task
        finally:
            self.pulse_s = time.monotonic()
            for one in (task, stop):
                one.cancel()
            await asyncio.gather(task, stop, return_exceptions=True)

    async def _talk(self, client: BrokerClient) -> None:
        """Take requests and publish until the connection is lost or `stop`."""
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
        async for message in client.messages:
            incoming = incoming_of(message, self.topics)
            if incoming is not None:
                self._on_request(incoming)

    async def _send(self, client: BrokerClient) -> None:
        while True:
            self.pulse_s = time.monotonic()
            # the state that an event has changed goes out, and is acknowledged, together with it
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
        """What the broker takes at once; what it never would is given up."""
        while True:
            batch = self.outbox.take(1 if self._suspicion.wary else min(_BATCH, client.most_unacknowledged))
            most = client.largest_packet
            large = [message for message in batch if most is not None and _size(message) > most]
            if not large:
                return batch
            for message in large:
                self._give_up(message, f"the broker takes packets of {most} bytes at most")

    async def _send_batch(self, client: aiomqtt.Client, batch: list[Outgoing]) -> None:
        """Several at once, in order: a radio with a long way there and back must not be waited for each time."""
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
        """Whether the connection may have ended because of what was being sent, which is given up in the end."""
        waiting, self._under_way = self._under_way, []
        taken_over = getattr(getattr(error, "rc", None), "value", None) == _TAKEN_OVER
        if not waiting or taken_over or time.monotonic() - self._sent_s > _AT_ONCE_S:
            return False
        if self._suspicion.ended(waiting[0], alone=len(waiting) == 1):
            self._give_up(waiting[0], f"the broker ends the connection at it ({error})")
        return True

    def _give_up(self, message: Outgoing, why: str) -> None:
        _log.error("a message was given up", topic=message.topic[:200], size=len(message.payload), error=why)
        self.outbox.give_up(message)

    # --- details of the protocol

    async def _client(self) -> BrokerClient:
        connect = None
        if self._five:
            connect = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            # requests that are on their way when a radio loses us for seconds still come, unless they expire
            connect.SessionExpiryInterval = _SESSION_EXPIRY_S
            connect.MaximumPacketSize = _LARGEST_PACKET
        return await broker_client(
            self._settings,
            identifier=f"panoexec-{self.topics.base.replace('/', '-')}",
            connect=connect,
            # what was asked for while this process did not run is not obeyed by it
            clean_start=self._times == 0 if self._five else 3,
            clean_session=None if self._five else True,
            will=aiomqtt.Will(self.topics.status, OFFLINE, qos=1, retain=True),
            queue_type=Inbox,
            max_queued_incoming_messages=_INCOMING,
            max_inflight_messages=_BATCH + 4,
        )

    async def _subscribe(self, client: aiomqtt.Client) -> None:
        if self._five:
            # the broker tells us which requests were published with the retain flag, so that they can be refused
            options = SubscribeOptions(qos=1, retainAsPublished=True, retainHandling=0)
            answer = await client.subscribe(self.topics.requests, options=options)
        else:
            answer = await client.subscribe(self.topics.requests, qos=1)
        code = answer[0]
        if getattr(code, "value", code) >= _REFUSED:
            raise aiomqtt.MqttError(f"the broker does not let us read {self.topics.requests}: look at its ACL")

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
            text = f"each connection ends at once: do two daemons have the vehicle id {self._vehicle!r}? ({text})"
        self.reason = text
        if text != self._said:
            _log.warning("no broker", host=self._settings.host, port=self._settings.port, error=text)
        self._said = text


def _with_reason(client: aiomqtt.Client, error: aiomqtt.MqttError) -> aiomqtt.MqttError:
    """The error with the broker's reason for the end of the connection, which the client keeps to itself."""
    ended = client._disconnected  # noqa: SLF001
    reason = ended.exception() if ended.done() and not ended.cancelled() else None
    return reason if isinstance(reason, aiomqtt.MqttError) else error


def _size(message: Outgoing) -> int:
    return len(message.payload) + len(message.topic.encode()) + len(message.correlation or b"") + _HEAD


@contextlib.asynccontextmanager
async def running(link: MqttLink) -> AsyncIterator[MqttLink]:
    """The link while the block runs; says `offline` at its end."""
    async with asyncio.TaskGroup() as group:
        group.create_task(link.run(), name="mqtt link")
        try:
            yield link
        finally:
            link.stop()
