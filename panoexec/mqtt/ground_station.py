"""A small ground station: asks for things and listens, for the command line and for tests."""

from __future__ import annotations

import asyncio
import json
import math
import uuid
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Final, Literal, Self, TypeAlias

import aiomqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from panoexec.errors import LinkError
from panoexec.inputs.config import MqttSection
from panoexec.mqtt.certificates import explained
from panoexec.mqtt.client import broker_client

Kind: TypeAlias = Literal["status", "state", "plan", "event"]

_KINDS: Final[dict[str, Kind]] = {"status": "status", "state": "state", "plan": "plan", "event": "event"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """One message of a vehicle; `document` is parsed JSON, the plain text for `status`, None for a cleared topic."""

    vehicle: str
    kind: Kind
    document: Any


class GroundStation:
    """An async context manager around one connection to the broker."""

    def __init__(self, settings: MqttSection) -> None:
        """Describe it; `settings.host` is set."""
        self._settings = settings
        self._five = settings.protocol == "5"
        self._stack = AsyncExitStack()
        self._client: aiomqtt.Client | None = None

    async def __aenter__(self) -> Self:
        """Connect.

        Raises:
            LinkError: the broker cannot be reached or refuses.
            UsageError: a password or certificate file is wrong.
        """
        settings = self._settings
        assert settings.host is not None
        client = await broker_client(settings, identifier="panoexec-ground-")
        try:
            self._client = await self._stack.enter_async_context(client)
        except aiomqtt.MqttError as error:
            why = explained(str(error), settings)
            raise LinkError(f"no broker at {settings.host}:{settings.port}: {why}") from error
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Disconnect."""
        try:
            await self._stack.__aexit__(exc_type, exc, traceback)
        except aiomqtt.MqttError:
            return  # it is gone anyway

    async def request(
        self, vehicle: str, command: str, fields: dict[str, Any], *, timeout_s: float, expiry_s: int | None = None
    ) -> dict[str, Any]:
        """Ask a vehicle for something and return the answer.

        Args:
            vehicle: its id.
            command: what to do.
            fields: of the request; a transaction is added if there is none.
            timeout_s: how long to wait for the answer.
            expiry_s: the broker drops the request after this (MQTT 5); the timeout, rounded up, if not given.

        Raises:
            LinkError: no answer, or the broker was lost.
        """
        assert self._client is not None
        base = f"{self._settings.prefix}/{vehicle}"
        fields = {"transaction": uuid.uuid4().hex} | fields
        properties = None
        if self._five:
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            properties.MessageExpiryInterval = expiry_s or max(1, math.ceil(timeout_s))
            properties.ContentType = "application/json"
        try:
            async with asyncio.timeout(timeout_s):
                await self._client.subscribe(f"{base}/response/{command}", qos=1)
                payload = json.dumps(fields).encode()
                await self._client.publish(f"{base}/request/{command}", payload, qos=1, properties=properties)
                async for message in self._client.messages:
                    answer = _json(message.payload)
                    if isinstance(answer, dict) and answer.get("transaction") == fields["transaction"]:
                        return answer
        except TimeoutError as error:
            raise LinkError(
                f"{vehicle} did not answer {command} within {timeout_s:g} s: is its status online (panoexec watch)?"
            ) from error
        except aiomqtt.MqttError as error:
            raise LinkError(f"the broker was lost: {error}") from error
        raise AssertionError("the messages never end")

    async def listen(self, vehicle: str | None) -> AsyncGenerator[Heard, None]:
        """What vehicles say, the retained things first.

        Args:
            vehicle: its id; None for all below the prefix.

        Raises:
            LinkError: the broker was lost.
        """
        assert self._client is not None
        prefix = self._settings.prefix
        try:
            for name in _KINDS:
                await self._client.subscribe(f"{prefix}/{vehicle or '+'}/{name}", qos=1)
            async for message in self._client.messages:
                who, _, name = str(message.topic).removeprefix(f"{prefix}/").rpartition("/")
                kind = _KINDS.get(name)
                if kind is not None and isinstance(message.payload, bytes):
                    text = message.payload.decode(errors="replace")
                    yield Heard(vehicle=who, kind=kind, document=text if kind == "status" else _json(message.payload))
        except aiomqtt.MqttError as error:
            raise LinkError(f"the broker was lost: {error}") from error


def _json(payload: object) -> Any:
    if not isinstance(payload, bytes) or not payload:
        return None
    try:
        return json.loads(payload)
    except ValueError:
        return None
