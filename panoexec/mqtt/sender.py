"""Sending what is in the outbox, at the pace of the link and on the terms of the broker."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import aiomqtt
import structlog
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from panoexec.mqtt.client import REFUSED, BrokerClient
from panoexec.mqtt.dialer import BEST, TAKEN_OVER, Terms
from panoexec.mqtt.outbox import Outbox, Outgoing
from panoexec.mqtt.pace import Pace
from panoexec.mqtt.state_forms import StateForms
from panoexec.mqtt.suspicion import Suspicion
from panoexec.mqtt.topics import Topics

PULSE_S: Final = 2.0
REPEAT_S: Final = 15.0
"""Without retained messages the status is repeated so often."""

BATCH: Final = 16
BESIDE: Final = 4
"""Urgent messages that are sent while a batch waits for its acknowledgements."""

_HELD_S: Final = 0.1
_ANSWER_S: Final = 0.15
_AT_ONCE_S: Final = 3.0

_log = structlog.get_logger(__name__)


class Sender:
    """Sends the messages of the outbox over one connection after the other.

    Attributes:
        outbox: what is to be sent.
        terms: of the connection.
        pace: of the connection.
        repeats_status: whether the status is repeated although the broker retains it.
    """

    def __init__(self, topics: Topics, *, five: bool, keepalive_s: float) -> None:
        """Describe the sender.

        Args:
            topics: of the vehicle.
            five: whether with MQTT 5.
            keepalive_s: of the connections; nothing may occupy the link for longer.
        """
        self.outbox = Outbox()
        self.terms: Terms = BEST
        self.pace = Pace()
        self.repeats_status = False
        self._topics = topics
        self._five = five
        self._keepalive_s = keepalive_s
        self._suspicion = Suspicion()
        self._forms = StateForms(topics)
        self._under_way: list[Outgoing] = []
        self._hurry = asyncio.Event()
        """Set when there is an urgent message."""
        self._ends = False
        self._sent_s = -math.inf
        self._answered_s = -math.inf
        self._announced_s = -math.inf
        self._said: set[tuple[str, str]] = set()

    @property
    def wary(self) -> bool:
        """Whether messages are sent one by one, to find one that the broker does not bear."""
        return self._suspicion.wary

    def put(self, message: Outgoing) -> None:
        """Queue a message, unless the broker has it and the link is too slow to repeat it."""
        if message.answer:
            self._answered_s = time.monotonic()
        if message.urgent:
            self._hurry.set()
        if message.retain and self.terms.retain and math.isfinite(self.pace.rate) and self.outbox.is_held(message):
            return
        self.outbox.put(message)

    def connected(self, terms: Terms, *, round_trip_s: float) -> None:
        """Begin with a connection: everything retained is sent again."""
        self.terms, self.pace = terms, Pace(round_trip_s)
        self._forms.connected(may=self._five and terms.retain and terms.qos > 0)
        self._announced_s = time.monotonic()
        self.outbox.renew()

    def announce(self, payload: bytes) -> None:
        """Send the status again, if the broker does not keep it."""
        if not self.terms.retain or self.repeats_status:
            self._announced_s = time.monotonic()
            self.outbox.put(Outgoing(topic=self._topics.status, payload=payload, retain=True))

    async def greet(self, client: BrokerClient, payload: bytes) -> None:
        """Send the status at once.

        Raises:
            aiomqtt.MqttError: the connection is lost.
        """
        message = Outgoing(topic=self._topics.status, payload=payload, retain=True)
        self._judge(message, await self._send(client, message))

    async def run(self, client: BrokerClient, *, online: bytes, pulse: Callable[[], None], stop: asyncio.Event) -> None:
        """Send until the connection is lost, or until nothing is left after `stop`.

        Args:
            client: connected.
            online: the status to repeat.
            pulse: called at least every two seconds.
            stop: set to end; `outbox.filled` must be set too.

        Raises:
            aiomqtt.MqttError: the connection is lost.
        """
        idle = False
        while True:
            pulse()
            self._ends = stop.is_set()
            # yield, so that an event and the state that it changes are sent in one batch
            await asyncio.sleep(0)
            if time.monotonic() - self._announced_s >= REPEAT_S:
                self.announce(online)
            self.outbox.filled.clear()
            batch = self.next_batch(client)
            if batch and idle and self._may_be_overtaken(batch):
                idle = False
                await asyncio.sleep(_ANSWER_S)
            elif batch:
                idle = False
                await self._send_batch(client, batch)
            elif stop.is_set():
                return
            else:
                idle = True
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_HELD_S if len(self.outbox) else PULSE_S):
                        await self.outbox.filled.wait()

    def _may_be_overtaken(self, batch: list[Outgoing]) -> bool:
        """Whether an answer that follows at once, as after the first event of a `start`, should go first."""
        return math.isfinite(self.pace.rate) and not any(message.answer for message in batch)

    def next_batch(self, client: BrokerClient) -> list[Outgoing]:
        """The next messages that the broker accepts; those above its maximum packet size are dropped."""
        while True:
            most = 1 if self._suspicion.wary else min(BATCH, client.limits.most_unacknowledged)
            batch = self.outbox.take(most, self.pace.window, form=self._form)
            reasons = [(message, self._never(client, message)) for message in batch]
            if not any(why for _, why in reasons):
                return batch
            for message, why in reasons:
                if why:
                    self._give_up(message, why)

    def _form(self, message: Outgoing, waited_s: float) -> Outgoing | None:
        """As what a message of a retained topic may be sent now; None if it has to wait."""
        now, held = time.monotonic(), self.outbox.held(message.topic)
        if self._ends and message.topic == self._topics.state:
            return message  # the last state, which stays at the broker: as a whole, and not later
        for form in self._forms.of(message, held=held, slow=self.pace.lastingly_slow):
            if self.pace.may_go(
                form.size, waited_s=waited_s, now_s=now, answered_s=self._answered_s, delta=not form.retain
            ):
                return form
        return None

    def _never(self, client: BrokerClient, message: Outgoing) -> str:
        """Why a message cannot be sent over this connection; "" if it can."""
        most = client.limits.largest_packet
        if most is not None and message.size > most:
            return f"exceeds the broker's maximum packet size of {most} bytes"
        took_s = self.pace.takes_s(message.size)
        if took_s > self._keepalive_s:
            return f"would occupy this slow link for {took_s:.0f} s, longer than keepalive_s"
        return ""

    async def _send_batch(self, client: BrokerClient, batch: list[Outgoing]) -> None:
        """Send several messages at once, in order, to avoid a round trip per message on slow radio links."""
        self._under_way, self._sent_s = list(batch), time.monotonic()
        size = sum(message.size for message in batch)
        timeout_s = self.pace.timeout_s(size)
        sends = [asyncio.ensure_future(self._send(client, message, timeout_s=timeout_s)) for message in batch]
        try:
            while (results := await self._results(sends)) is None:
                for message in self._urgent_beside(client, batch):
                    batch.append(message)
                    self._under_way.append(message)
                    size += message.size
                    sends.append(asyncio.ensure_future(self._send(client, message, timeout_s=timeout_s)))
        finally:
            for send in sends:
                send.cancel()
        for message, result in zip(batch, results, strict=True):
            if isinstance(result, BaseException):
                raise result
            self._judge(message, result)
            if result >= REFUSED and message.topic == self._topics.state_delta:
                self._forms.refuse()  # the state is still to be sent
            else:
                self._forms.sent(message)
                self.outbox.done(message)
            self._under_way.remove(message)
        now = time.monotonic()
        latest = sum(message.size for message in batch if message.retain)
        deltas = sum(message.size for message in batch if message.topic == self._topics.state_delta)
        self.pace.acknowledged(size, now - self._sent_s, now_s=now, latest=latest, deltas=deltas)
        self._suspicion.acknowledged(batch, left=len(self.outbox))

    async def _results(self, sends: Sequence[asyncio.Future[int]]) -> list[int | BaseException] | None:
        """What became of messages; None if an urgent one does not want to wait for that."""
        self._hurry.clear()
        hurry = asyncio.ensure_future(self._hurry.wait())
        everything = asyncio.ensure_future(asyncio.wait(sends))
        try:
            await asyncio.wait({everything, hurry}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            everything.cancel()
            hurry.cancel()
            await asyncio.gather(everything, hurry, return_exceptions=True)
        if not all(send.done() for send in sends):
            return None
        return await asyncio.gather(*sends, return_exceptions=True)

    def _urgent_beside(self, client: BrokerClient, batch: list[Outgoing]) -> list[Outgoing]:
        """Urgent messages that the broker accepts although it has not acknowledged the batch yet."""
        room = min(BATCH + BESIDE, client.limits.most_unacknowledged) - len(batch)
        if self._suspicion.wary or room <= 0:
            return []
        urgent = [one for one in self.outbox.urgent if one not in batch and not self._never(client, one)]
        return urgent[:room]

    async def _send(self, client: BrokerClient, message: Outgoing, *, timeout_s: float = 10.0) -> int:
        return await client.send(
            message.topic,
            message.payload,
            qos=self.terms.qos,
            retain=message.retain and self.terms.retain,
            properties=self._properties(message),
            timeout_s=timeout_s,
        )

    def _judge(self, message: Outgoing, code: int) -> None:
        """Say once for each topic that the broker refuses what is published there."""
        if code >= REFUSED and (message.topic, str(code)) not in self._said:
            self._said.add((message.topic, str(code)))
            _log.error(
                "the broker refuses a message: check its ACL", topic=message.topic[:200], reason_code=f"0x{code:02X}"
            )

    def blame(self, error: Exception) -> bool:
        """Whether an unacknowledged message may have ended the connection; it is dropped after repeated failures."""
        waiting, self._under_way = self._under_way, []
        taken_over = getattr(getattr(error, "rc", None), "value", None) == TAKEN_OVER
        if not waiting or taken_over or time.monotonic() - self._sent_s > _AT_ONCE_S:
            return False
        if self._suspicion.ended(waiting[0], alone=len(waiting) == 1):
            self._give_up(waiting[0], f"the broker closes the connection when it is sent ({error})")
        return True

    def _give_up(self, message: Outgoing, why: str) -> None:
        if (message.topic, why) not in self._said:
            self._said.add((message.topic, why))
            _log.error(
                "message dropped: it cannot be sent", topic=message.topic[:200], size=len(message.payload), error=why
            )
        if message.topic == self._topics.state_delta:
            self._forms.refuse()
        self.outbox.give_up(message)
        if message.topic == self._topics.plan and message.payload:
            # the plan of an earlier mission must not stand for this one
            self.outbox.put(Outgoing(topic=message.topic, payload=b"", retain=True))
        elif message.answer and (short := _without_data(message)) is not None:
            self.outbox.put(short)

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


def _without_data(message: Outgoing) -> Outgoing | None:
    """The answer without its `data`, which says at least whether the request was obeyed; None if it has none."""
    try:
        answer = json.loads(message.payload)
    except ValueError:
        return None
    if not isinstance(answer, dict) or answer.get("data") is None:
        return None
    payload = json.dumps(answer | {"data": None}, separators=(",", ":")).encode("ascii")
    return replace(message, payload=payload)


def with_reason(client: aiomqtt.Client, error: aiomqtt.MqttError) -> aiomqtt.MqttError:
    """The error with the reason code of the disconnection, which aiomqtt does not expose."""
    ended = client._disconnected  # noqa: SLF001
    reason = ended.exception() if ended.done() and not ended.cancelled() else None
    return reason if isinstance(reason, aiomqtt.MqttError) else error
