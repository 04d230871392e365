"""A minimal ground station client: sends requests and receives messages, for the command line and tests."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import uuid
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Any, Final, Literal, Self, TypeAlias

import aiomqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from panoexec.errors import LinkError
from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.certificates import explained
from panoexec.mqtt.client import BrokerClient, broker_client
from panoexec.mqtt.state_deltas import StateFollower
from panoexec.suggestions import did_you_mean

Kind: TypeAlias = Literal["status", "state", "plan", "event"]

_STATUS_S: Final = 0.3
"""How long to wait for a retained status; a broker sends it with the acknowledgement of the subscription."""
_OTHERS_S: Final = 1.0
"""How long a broker is silent, on a slow link too, when it has told the retained status of every vehicle."""
_UNTOLD: Final = "whether it received the request is not known"
"""After a request was sent and not answered."""
_DELTA: Final = "state/delta"
_KINDS: Final[dict[str, Kind]] = {"status": "status", "state": "state", "plan": "plan", "event": "event"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """A received message; `document` is parsed JSON, plain text for `status`, None for a cleared topic."""

    vehicle: str
    kind: Kind
    document: Any


class GroundStation:
    """An async context manager for one connection to the broker."""

    def __init__(self, settings: MqttSection) -> None:
        """Create a client; `settings.host` must be set."""
        self._settings = settings
        self._five = settings.protocol == "5"
        self._stack = AsyncExitStack()
        self._client: BrokerClient | None = None

    async def __aenter__(self) -> Self:
        """Connect.

        Raises:
            LinkError: the broker cannot be reached or rejects the connection.
            UsageError: a password or certificate file is invalid.
        """
        settings = self._settings
        assert settings.host is not None
        client = await broker_client(settings, identifier="panoexec-ground-")
        try:
            self._client = await self._stack.enter_async_context(client)
        except aiomqtt.MqttError as error:
            why = explained(str(error), settings)
            raise LinkError(f"no connection to broker {settings.host}:{settings.port}: {why}") from error
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Disconnect."""
        try:
            await self._stack.__aexit__(exc_type, exc, traceback)
        except aiomqtt.MqttError:
            return  # the connection is already lost

    async def request(
        self,
        vehicle: str,
        command: str,
        fields: dict[str, Any],
        *,
        timeout_s: float,
        expiry_s: int | None = None,
        on_silence: Callable[[], None] = lambda: None,
    ) -> dict[str, Any]:
        """Send a request to a vehicle and return the response.

        Args:
            vehicle: vehicle id.
            command: name of the command.
            fields: request fields; a transaction is added if there is none.
            timeout_s: response timeout.
            expiry_s: message expiry (MQTT 5); default: the timeout, rounded up.
            on_silence: called when the request waits although the broker knows of no vehicle of this id. It is sent
                again, with the same transaction, when the vehicle comes.

        Raises:
            LinkError: the vehicle is offline, so that nothing was sent; the broker knows other vehicles but not this
                one; no response within the timeout, or the connection to the broker was lost.
        """
        assert self._client is not None
        base = f"{self._settings.prefix}/{vehicle}"
        fields = {"transaction": uuid.uuid4().hex} | fields
        status, untold = None, ""
        try:
            async with asyncio.timeout(timeout_s):
                await self._client.subscribe(f"{base}/response/{command}", qos=1)
                status = await self._status(f"{base}/status", min(_STATUS_S, timeout_s / 3))
                if status == "offline":
                    raise LinkError(f"{vehicle} is offline: its daemon is not connected to this broker")
                expiry_s = expiry_s or max(1, math.ceil(timeout_s))
                send = partial(self._publish, f"{base}/request/{command}", fields, expiry_s)
                untold = f"; {_UNTOLD}"
                await send()
                answer = None
                if status is None and await self._ask_for_all():
                    silence_s = min(_OTHERS_S, timeout_s / 3)
                    answer = await self._until_known(vehicle, fields["transaction"], silence_s, on_silence, send)
                return answer or await self._answer(vehicle, command, fields["transaction"], None if status else send)
        except TimeoutError as error:
            unknown = "no vehicle of this id has been connected to this broker" if status is None else "it is online"
            late = f"{vehicle} did not respond to {command} within {timeout_s:g} s"
            raise LinkError(f"{late}: {unknown}{untold}") from error
        except aiomqtt.MqttError as error:
            raise LinkError(f"connection to the broker lost: {error}{untold}") from error

    async def _answer(
        self, vehicle: str, command: str, transaction: object, again: Callable[[], Awaitable[None]] | None
    ) -> dict[str, Any]:
        """Wait for the answer; `again` sends the request once more when the vehicle comes online."""
        assert self._client is not None
        status = f"{self._settings.prefix}/{vehicle}/status"
        async for message in self._client.messages:
            if str(message.topic) == status:
                if message.payload == b"offline":
                    raise LinkError(f"{vehicle} went offline before it responded to {command}; {_UNTOLD}")
                if again is not None:
                    await again()  # the same transaction acts once
                    again = None
            elif (answer := _answer_to(transaction, message.payload)) is not None:
                return answer
        raise AssertionError("the messages never end")

    async def _until_known(
        self,
        vehicle: str,
        transaction: object,
        silence_s: float,
        on_silence: Callable[[], None],
        again: Callable[[], Awaitable[None]],
    ) -> dict[str, Any] | None:
        """Read what the broker keeps of all vehicles, until it is silent or the answer comes.

        `again` sends the request once more if the vehicle is among them: it may have come only now.

        Raises:
            LinkError: it knows others but not this one, which has not answered either; the message names them.
        """
        assert self._client is not None
        known: set[str] = set()
        with contextlib.suppress(TimeoutError):
            while True:
                async with asyncio.timeout(silence_s):
                    message = await anext(self._client.messages)
                who, _, name = str(message.topic).removeprefix(f"{self._settings.prefix}/").partition("/")
                if name == "status" and message.payload:
                    known.add(who)
                    if who == vehicle and message.payload == b"offline":
                        raise LinkError(f"{vehicle} is offline: its daemon is not connected to this broker; {_UNTOLD}")
                    if who == vehicle:
                        await again()  # the same transaction acts once
                elif (answer := _answer_to(transaction, message.payload)) is not None:
                    return answer
        if not known:
            on_silence()
        elif vehicle not in known:
            hint = did_you_mean(vehicle, known) or f"there are {', '.join(sorted(known))}."
            # an access list may hide its status, and with MQTT 3.1.1 nobody says so
            unknown = "The request was sent: one that is hidden from this user may have received it"
            raise LinkError(f"no vehicle {vehicle} has been connected to this broker: {hint} {unknown}")
        return None

    async def _status(self, topic: str, wait_s: float) -> str | None:
        """The retained status of a vehicle; None if the broker has none, or does not let us read it."""
        assert self._client is not None
        try:
            await self._client.subscribe(topic, qos=1)
            async with asyncio.timeout(wait_s):
                async for message in self._client.messages:
                    if str(message.topic) == topic and isinstance(message.payload, bytes):
                        return message.payload.decode(errors="replace")
        except (TimeoutError, aiomqtt.MqttCodeError):
            return None
        raise AssertionError("the messages never end")

    async def _ask_for_all(self) -> bool:
        """Ask for the retained status of every vehicle; false where the broker cannot tell."""
        assert self._client is not None
        limits = self._client.limits
        if not limits.retain or not limits.wildcards:
            return False
        with contextlib.suppress(aiomqtt.MqttCodeError):
            await self._client.subscribe(f"{self._settings.prefix}/+/status", qos=1)
            return True
        return False

    async def _publish(self, topic: str, fields: dict[str, Any], expiry_s: int = 10) -> None:
        assert self._client is not None
        properties = None
        if self._five:
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            properties.MessageExpiryInterval = expiry_s
            properties.ContentType = "application/json"
        qos = min(1, self._client.limits.max_qos)
        await self._client.publish(topic, json.dumps(fields).encode(), qos=qos, properties=properties)

    async def listen(self, vehicle: str | None) -> AsyncGenerator[Heard, None]:
        """Receive the messages of vehicles, retained messages first; deltas of a state arrive as whole states.

        Args:
            vehicle: vehicle id; None for all vehicles below the prefix.

        Yields:
            Each message.

        Raises:
            LinkError: the connection to the broker was lost.
        """
        assert self._client is not None
        prefix = self._settings.prefix
        followers: dict[str, StateFollower] = {}
        try:
            for name in (*_KINDS, _DELTA):
                await self._client.subscribe(f"{prefix}/{vehicle or '+'}/{name}", qos=1)
            if vehicle is not None and not self._client.limits.retain:
                # this broker keeps nothing: ask for what it would have kept; who may not write requests waits
                await self._publish(f"{prefix}/{vehicle}/request/get", {"transaction": uuid.uuid4().hex})
            async for message in self._client.messages:
                where = str(message.topic).removeprefix(f"{prefix}/")
                if not isinstance(message.payload, bytes):
                    continue
                who, _, name = where.partition("/")
                follower = followers.setdefault(who, StateFollower())
                if name == _DELTA:
                    if (state := follower.delta(_json(message.payload))) is not None:
                        yield Heard(vehicle=who, kind="state", document=state)
                elif name == "state":
                    yield Heard(vehicle=who, kind="state", document=follower.whole(_json(message.payload)))
                elif (kind := _KINDS.get(name)) is not None:
                    text = message.payload.decode(errors="replace")
                    yield Heard(vehicle=who, kind=kind, document=text if kind == "status" else _json(message.payload))
        except aiomqtt.MqttError as error:
            raise LinkError(f"connection to the broker lost: {error}") from error


def _answer_to(transaction: object, payload: object) -> dict[str, Any] | None:
    answer = _json(payload)
    return answer if isinstance(answer, dict) and answer.get("transaction") == transaction else None


def _json(payload: object) -> Any:
    if not isinstance(payload, bytes) or not payload:
        return None
    try:
        return json.loads(payload)
    except ValueError:
        return None
