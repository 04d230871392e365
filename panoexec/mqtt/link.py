"""The connection to the broker: reconnects without limit, receives requests and publishes all other topics.

A mission never waits for the broker: messages are put into a bounded outbox and removed when the broker has
acknowledged them (QoS 1). A message can therefore be delivered twice, but it is not lost with a connection.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any, Final, NoReturn

import aiomqtt
import structlog
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from panoexec.errors import PanoexecError
from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.certificates import explained
from panoexec.mqtt.client import CONNECT_S, BrokerClient, broker_client
from panoexec.mqtt.client_id import another_client_id, client_id
from panoexec.mqtt.dialer import TAKEN_OVER, Dialer, Terms
from panoexec.mqtt.incoming import Inbox, Incoming, incoming_of
from panoexec.mqtt.outbox import Outgoing
from panoexec.mqtt.pace import BATCH_S
from panoexec.mqtt.requests import STOPPING
from panoexec.mqtt.sender import BATCH, BESIDE, PULSE_S, Sender, with_reason
from panoexec.mqtt.subscribing import subscribe_requests, subscribe_state
from panoexec.mqtt.topics import Topics, is_topic_part
from panoexec.mqtt.twin import TwinWatch

ONLINE: Final = b"online"
OFFLINE: Final = b"offline"

BACKOFF_S: Final = 1.0
BACKOFF_MOST_S: Final = 30.0
_STEADY_S: Final = 10.0
_FAREWELL_S: Final = 1.0
_SPARE_S: Final = 5.0
_SESSION_EXPIRY_S: Final = 30
_INCOMING: Final = 500
_LARGEST_PACKET: Final = 16 * 2**20
_SUSPICIOUS: Final = 2
_CLOSINGS_S: Final = 120.0
_NO_REASON: Final = 128
_log = structlog.get_logger(__name__)


class MqttLink:
    """Keeps a connection to the broker; `run` it in a task.

    Attributes:
        topics: topics of the vehicle.
        connected: whether there is a connection.
        pulse_s: time.monotonic of the last progress of the task.
        reason: why there is no connection; "" if connected.
        outbox: messages that wait.
        twin: whether another daemon publishes as this vehicle.
    """

    def __init__(
        self,
        settings: MqttSection,
        *,
        vehicle: str,
        on_request: Callable[[Incoming], None],
        on_connected: Callable[[], None] = lambda: None,
        backoff_s: float = BACKOFF_S,
        boot_id: str = "",
    ) -> None:
        """Create the link.

        Args:
            settings: broker and credentials; `host` is set.
            vehicle: vehicle id.
            on_request: called with each request; must return immediately and not raise.
            on_connected: called at each connection, before anything is published.
            backoff_s: pause after the first failure, doubled up to `BACKOFF_MOST_S`.
            boot_id: of this process, as in its states; "" does not watch for another daemon.
        """
        self.topics = Topics(settings.prefix, vehicle)
        self.connected = False
        self.pulse_s = time.monotonic()
        self.reason = "not connected yet"
        self._settings = settings
        self._vehicle = vehicle
        self._on_request = on_request
        self._on_connected = on_connected
        self._backoff_s = backoff_s
        self._five = settings.protocol == "5"
        self._sender = Sender(self.topics, five=self._five, keepalive_s=settings.keepalive_s)
        self.outbox = self._sender.outbox
        self._dialer = Dialer(self._client, five=self._five)
        self._twins = TwinWatch(boot_id)
        self._identifier = client_id(self.topics)
        self._may_move = bool(boot_id)
        self._moved = False
        self._closings: list[float] = []
        """When the broker closed a working connection without a reason, since the last failure to connect."""
        self._times = 0
        self._connections = 0
        self._stopping = asyncio.Event()
        self._talking: BrokerClient | None = None
        self._said = ""
        self._told: list[str] = []
        self._short = 0

    @property
    def twin(self) -> bool:
        """See the class."""
        return self._twins.present

    # --- publishing

    def publish(self, topic: str, payload: bytes, *, retain: bool = False) -> None:
        """Queue a message, which is published as soon as the broker is connected; never blocks."""
        self._sender.put(Outgoing(topic=topic, payload=payload, retain=retain))

    def announce(self) -> None:
        """Publish the status again, if the broker does not keep it."""
        self._sender.announce(ONLINE)

    async def publish_spare(self, topic: str, payload: bytes) -> bool:
        """Publish a message with QoS 0 that may be lost, if the link has room for it now.

        Returns:
            Whether it was sent: not while anything else waits, nor on a link on which it would take longer than
            everything else may.
        """
        client, size = self._talking, len(payload) + len(topic)
        if client is None or len(self.outbox) or self._sender.pace.takes_s(size) > BATCH_S:
            return False
        try:
            await client.publish(topic, payload, qos=0, timeout=_SPARE_S)
        except (aiomqtt.MqttError, ValueError):
            return False
        return True

    def respond(self, request: Incoming, payload: bytes) -> None:
        """Publish a response on the response topic of the command, and on that of the request if it is allowed."""
        usual = self.topics.response(request.command if is_topic_part(request.command) else "unknown")
        self._answer(usual, payload, request)
        if not request.response_topic or request.response_topic == usual:
            return
        if self.topics.may_answer_at(request.response_topic):
            self._answer(request.response_topic, payload, request)
        else:
            _log.warning("response topic rejected", topic=request.response_topic[:200], allowed_below=self.topics.base)

    def _answer(self, topic: str, payload: bytes, request: Incoming) -> None:
        urgent = request.command in STOPPING
        message = Outgoing(topic=topic, payload=payload, answer=True, urgent=urgent, correlation=request.correlation)
        self._sender.put(message)

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
                self._note_closing(error)
                self._lost(error)
                if self._sender.blame(error) or self._thrown_off(error):
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
            self._pulse()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(min(left, PULSE_S)):
                    await self._stopping.wait()

    def _pulse(self) -> None:
        self.pulse_s = time.monotonic()

    async def _session(self) -> None:
        """Run one connection until it ends."""
        async with contextlib.AsyncExitStack() as stack:
            client = await self._until_stop(self._dialer.dial(stack))
            began = time.monotonic()
            await subscribe_requests(client, self.topics, five=self._five)
            round_trip_s = time.monotonic() - began
            await self._watch_for_twin(client)
            self._times += 1
            self._connections += 1
            self.reason, self.connected = "", True
            _log.info("broker connected", host=self._settings.host, port=self._settings.port, topic=self.topics.base)
            self._tell_limitations()
            self._sender.connected(self._dialer.terms, round_trip_s=round_trip_s)
            await self._greet(client)
            self._on_connected()
            try:
                await self._talk(client)
            except aiomqtt.MqttError as error:
                raise with_reason(client, error) from error
            except asyncio.CancelledError:
                # the client disconnects regularly, so the broker does not send the will
                with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
                    async with asyncio.timeout(_FAREWELL_S):
                        await self._sender.greet(client, OFFLINE)
                raise

    async def _greet(self, client: BrokerClient) -> None:
        try:
            await self._sender.greet(client, ONLINE)
        except aiomqtt.MqttError as error:
            self._dialer.ended_at_greeting()
            raise with_reason(client, error) from error
        self._dialer.greeted()

    def _tell_limitations(self) -> None:
        limitations = self._dialer.terms.limitations()
        if limitations != self._told:
            for text in limitations or ["the broker keeps retained messages and has QoS 1 now"]:
                _log.warning("broker with limitations" if limitations else "broker without limitations", text=text)
        self._told = limitations

    async def _until_stop(self, connecting: Coroutine[Any, Any, BrokerClient]) -> BrokerClient:
        """Connect; a stop request interrupts the attempt."""
        task = asyncio.create_task(connecting, name="mqtt connection")
        stop = asyncio.create_task(self._stopping.wait(), name="mqtt stop")
        try:
            await asyncio.wait({task, stop}, return_when=asyncio.FIRST_COMPLETED, timeout=2 * CONNECT_S)
            if not task.done():
                raise aiomqtt.MqttError("the broker does not respond")
            return await task
        finally:
            self._pulse()
            for one in (task, stop):
                one.cancel()
            await asyncio.gather(task, stop, return_exceptions=True)

    async def _talk(self, client: BrokerClient) -> None:
        """Receive requests and publish messages until the connection is lost or `stop`."""
        reading = asyncio.create_task(self._read(client), name="mqtt requests")
        sending = asyncio.create_task(self._send(client), name="mqtt outbox")
        self._talking = client
        try:
            await asyncio.wait({reading, sending}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._talking = None
            for task in (reading, sending):
                task.cancel()
            results = await asyncio.gather(reading, sending, return_exceptions=True)
        for result in results:
            if isinstance(result, Exception):
                raise result

    async def _read(self, client: BrokerClient) -> None:
        inbox = client._queue  # noqa: SLF001
        assert isinstance(inbox, Inbox)
        async for message in client.messages:
            if str(message.topic) == self.topics.state:
                self._hear_state(bytes(message.payload or b""), retained=bool(message.retain))
            elif (incoming := incoming_of(message, self.topics)) is not None:
                self._on_request(incoming)
            await inbox.read_on()

    async def _send(self, client: BrokerClient) -> None:
        await self._sender.run(client, online=ONLINE, pulse=self._check_eyes, stop=self._stopping)
        await self._sender.greet(client, OFFLINE)

    # --- others with the same client id

    def _note_closing(self, error: Exception) -> None:
        now = time.monotonic()
        if not self.connected:
            self._closings = []  # there is trouble with broker or network
        elif getattr(getattr(error, "rc", None), "value", _NO_REASON) == _NO_REASON:
            self._closings = [one for one in self._closings if now - one < _CLOSINGS_S] + [now]

    def _thrown_off(self, error: Exception) -> bool:
        """Whether another client connected with this client id; the next connection uses another one then.

        Not every broker says so, and none with MQTT 3.1.1: that it closes working connections is the sign then.
        """
        told = getattr(getattr(error, "rc", None), "value", None) == TAKEN_OVER
        guessed = len(self._closings) >= _SUSPICIOUS and not self._sender.wary
        if not (told or guessed) or not self._may_move:
            return False
        self._move()
        return True

    def _move(self) -> None:
        """Use another client id from now on.

        The session stays with the other client: what was requested meanwhile is lost, and is never executed twice.
        """
        _log.warning(
            "another client uses this client id: connecting with another one",
            client_id=self._identifier,
            hint="bind client ids to users at the broker, or give each daemon a vehicle id of its own"
            if not self._moved
            else "the broker may give client ids by user name: give each program a user of its own",
        )
        self._identifier, self._moved, self._times = another_client_id(self.topics), True, 0
        self._closings = []
        # a connection that the broker still holds for the old client id would set the status to offline
        self._sender.repeats_status = True

    async def _watch_for_twin(self, client: BrokerClient) -> None:
        """With a client id of its own, this daemon must see whether another one obeys the same requests."""
        if not self._moved:
            return
        self._may_move = False  # also if the broker closes the connection now
        if not await subscribe_state(client, self.topics, five=self._five):
            self._move_back()
        self._may_move = True
        self._twins.watch()

    def _move_back(self) -> NoReturn:
        self._identifier, self._moved, self._may_move = client_id(self.topics), False, False
        raise aiomqtt.MqttError(
            f"not permitted to read {self.topics.state}, so that another daemon of vehicle {self._vehicle!r} would not "
            f"be seen: keeping the client id {self._identifier}"
        )

    def _check_eyes(self) -> None:
        self._pulse()
        if self._moved and self._twins.blind:
            self._move_back()

    def _hear_state(self, payload: bytes, *, retained: bool) -> None:
        if self._twins.hear(payload, retained=retained):
            _log.error(
                "another daemon publishes as this vehicle: no mission is started or resumed by this one",
                vehicle=self._vehicle,
            )

    # --- protocol details

    async def _client(self, terms: Terms) -> BrokerClient:
        connect = None
        if self._five:
            connect = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            # requests sent during a short loss of the connection are delivered afterwards, unless they expire
            connect.SessionExpiryInterval = _SESSION_EXPIRY_S
            connect.MaximumPacketSize = _LARGEST_PACKET
        return await broker_client(
            self._settings,
            identifier=self._identifier,
            connect=connect,
            # discard requests that were sent before this process started
            clean_start=self._times == 0 if self._five else 3,
            clean_session=None if self._five else True,
            will=aiomqtt.Will(self.topics.status, OFFLINE, qos=terms.qos, retain=terms.retain),
            queue_type=Inbox,
            max_queued_incoming_messages=_INCOMING,
            max_inflight_messages=BATCH + BESIDE,
        )

    def _lost(self, error: Exception) -> None:
        text = explained(str(error) or type(error).__name__, self._settings)
        if self._short >= _SUSPICIOUS and not self._sender.wary:
            text = (
                f"connections end immediately: check whether two daemons use the vehicle id {self._vehicle!r} ({text})"
            )
        self.reason = text
        if text != self._said:
            _log.warning(
                "broker connection failed, retrying", host=self._settings.host, port=self._settings.port, error=text
            )
        self._said = text


@contextlib.asynccontextmanager
async def running(link: MqttLink) -> AsyncIterator[MqttLink]:
    """Run the link during the block; publish `offline` at its end."""
    async with asyncio.TaskGroup() as group:
        group.create_task(link.run(), name="mqtt link")
        try:
            yield link
        finally:
            link.stop()
