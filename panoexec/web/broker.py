"""The connection to the broker: subscribed to all vehicles below the prefix, reconnected for ever."""

from __future__ import annotations

import asyncio
import json
import random
import uuid
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Final, Protocol, TypeAlias

import aiomqtt
import structlog
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from panoexec.errors import LinkError, PanoexecError
from panoexec.inputs.service_sections import MqttSection
from panoexec.mqtt.certificates import explained
from panoexec.mqtt.client import REFUSED, BrokerClient, broker_client
from panoexec.mqtt.state_deltas import StateFollower
from panoexec.web.protocol import is_mission, is_vehicle

RETRY_S: Final = 1.0
"""Pause between attempts to connect, with jitter: a page is right again 3 s after its link is."""

_SESSION_S: Final = 600
"""How long the broker keeps events for this process while the link is lost (MQTT 5)."""

_DELTA: Final = "state/delta"
_KINDS: Final = {"status": 0, "state": 0, _DELTA: 0, "plan": 1, "event": 1}
"""Topics of a vehicle and their QoS: states are outdated when the link is back, events are not."""

MAX_THUMBNAIL: Final = 64 * 1024
_LARGEST: Final = {"plan": 4 << 20, "state": 1 << 18, _DELTA: 1 << 18}
_LARGEST_OTHER: Final = 1 << 20
"""Bytes of a message; what is larger is none of panoexec's."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """A message of a vehicle: `kind` is `status`, `state`, `plan` or `event`; None for an empty payload.

    `retained`: the broker kept it, so that it tells nothing of now.
    """

    vehicle: str
    kind: str
    document: Any
    retained: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Thumbnail:
    """The picture of a shot."""

    vehicle: str
    mission_id: str
    shot: int
    jpeg: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """The answer to a request of anybody."""

    vehicle: str
    command: str
    document: dict[str, Any]


Heard: TypeAlias = Document | Thumbnail | Response


class Listener(Protocol):
    """Hears what the vehicles say."""

    def hear(self, message: Heard) -> None:
        """Take a message; must not raise."""
        ...

    def link_changed(self, link: BrokerLink) -> None:
        """The connection was made or lost."""
        ...


class BrokerLink:
    """Connects and listens in `run`, which is one task of the server.

    Attributes:
        up: whether there is a connection.
        since: when that changed.
        reason: why there is none.
    """

    def __init__(self, settings: MqttSection, *, listener: Listener, retry_s: float = RETRY_S) -> None:
        """Describe it; `settings.host` is set."""
        self.up = False
        self.since = datetime.now(UTC)
        self.reason = "not connected yet"
        self.prefix = settings.prefix
        self._settings = settings
        self._listener = listener
        self._retry_s = retry_s
        self._five = settings.protocol == "5"
        self._identifier = f"panoexec-web-{uuid.uuid4().hex[:12]}"
        self._client: BrokerClient | None = None
        self._known: set[str] = set()
        self._followers: dict[str, StateFollower] = {}
        self._connected_before = False

    async def run(self) -> None:
        """Connect, and reconnect after every loss, until cancelled."""
        while True:
            try:
                await self._session()
            except (aiomqtt.MqttError, PanoexecError, OSError, TimeoutError, ValueError) as error:
                why = explained(str(error), self._settings)
                where = f"{self._settings.host}:{self._settings.port}"
                self._changed(up=False, reason=f"no connection to the broker {where}: {why}")
            await asyncio.sleep(self._retry_s * random.uniform(0.5, 1.0))

    def _changed(self, *, up: bool, reason: str = "") -> None:
        if up == self.up and reason == self.reason:
            return
        if up != self.up:
            self.since = datetime.now(UTC)
        self.up, self.reason = up, reason
        _log.info("broker connected" if up else "broker not connected", reason=reason)
        self._listener.link_changed(self)

    async def _session(self) -> None:
        properties = None
        options: dict[str, Any] = {}
        if self._five:
            properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            properties.SessionExpiryInterval = _SESSION_S
            # a new process begins a new session, a later connection continues it: events wait in the broker
            options["clean_start"] = not self._connected_before
        else:
            options["clean_session"] = True
        async with AsyncExitStack() as stack:
            made = await broker_client(self._settings, identifier=self._identifier, connect=properties, **options)
            client = await stack.enter_async_context(made)
            self._connected_before = True
            await self._subscribe(client)
            self._client = client
            self._changed(up=True)
            try:
                async for message in client.messages:
                    self._take(str(message.topic), message.payload, retained=bool(message.retain))
            finally:
                self._client = None

    async def _subscribe(self, client: BrokerClient) -> None:
        """Subscribe, at each connection anew, which brings what is retained.

        Raises:
            LinkError: the broker does not allow it.
        """
        most = client.limits.max_qos
        refused = []
        for name, qos in (*_KINDS.items(), ("thumbnail/+/+", 0), ("response/+", 1)):
            code = await client.ask_for(f"{self.prefix}/+/{name}", qos=min(qos, most))
            if code >= REFUSED:
                refused.append(name)
        if "status" in refused and "state" in refused:
            raise LinkError(f"not permitted to read {self.prefix}/+/state: check the ACL of the broker")
        if refused:
            _log.warning("not permitted to read", topics=refused)
        if not client.limits.retain:
            for vehicle in sorted(self._known):
                with suppress(aiomqtt.MqttError):
                    await self._publish(client, vehicle, "get", {"transaction": uuid.uuid4().hex}, expiry_s=10)

    def _take(self, topic: str, payload: object, *, retained: bool) -> None:
        heard = parsed(topic.removeprefix(f"{self.prefix}/"), payload, retained=retained)
        if heard is not None:
            self._known.add(heard.vehicle)
            if isinstance(heard, Document) and (heard := self._followed(heard)) is None:
                return
            self._listener.hear(heard)

    def _followed(self, heard: Document) -> Document | None:
        """A delta of a state as the whole state; None if it tells nothing new. Other documents as they are."""
        follower = self._followers.setdefault(heard.vehicle, StateFollower())
        if heard.kind == "state":
            return replace(heard, document=follower.whole(heard.document))
        if heard.kind != _DELTA:
            return heard
        state = follower.delta(heard.document)
        return None if state is None else replace(heard, kind="state", document=state)

    async def request(
        self, vehicle: str, command: str, fields: dict[str, Any], *, expiry_s: int, response_topic: str = ""
    ) -> None:
        """Publish a request and wait until the broker has it.

        Args:
            vehicle: its id.
            command: name of the command.
            fields: with the transaction.
            expiry_s: after which the broker drops it (MQTT 5).
            response_topic: a further level below `response/<command>`; the daemon keeps one waiting plan for each.

        Raises:
            LinkError: there is no connection, or the broker refused it.
        """
        client = self._client
        if client is None:
            raise LinkError(self.reason or "no connection to the broker")
        try:
            code = await self._publish(
                client, vehicle, command, fields, expiry_s=expiry_s, response_topic=response_topic
            )
        except (aiomqtt.MqttError, ValueError) as error:
            raise LinkError(f"the broker did not take the request: {error}") from error
        if code >= REFUSED:
            raise LinkError("the broker refused the request: check its ACL and its packet size")

    async def _publish(
        self,
        client: BrokerClient,
        vehicle: str,
        command: str,
        fields: dict[str, Any],
        *,
        expiry_s: int,
        response_topic: str = "",
    ) -> int:
        properties = None
        base = f"{self.prefix}/{vehicle}"
        if self._five:
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            properties.MessageExpiryInterval = expiry_s
            properties.ContentType = "application/json"
            if response_topic:
                properties.ResponseTopic = f"{base}/response/{command}/{response_topic}"
        payload = json.dumps(fields, separators=(",", ":"), allow_nan=False).encode()
        qos = min(1, client.limits.max_qos)
        return await client.send(f"{base}/request/{command}", payload, qos=qos, retain=False, properties=properties)


def parsed(topic: str, payload: object, *, retained: bool = False) -> Heard | None:  # noqa: PLR0911  (one kind of message after the other)
    """What a message means; None for anything unexpected.

    Args:
        topic: below the prefix.
        payload: bytes of the message.
        retained: whether the broker kept it.
    """
    vehicle, _, rest = topic.partition("/")
    if not isinstance(payload, bytes) or not is_vehicle(vehicle) or len(payload) > _LARGEST.get(rest, _LARGEST_OTHER):
        return None
    if rest == "status":
        text = payload.decode(errors="replace")
        if text not in {"online", "offline"}:
            return None
        return Document(vehicle=vehicle, kind="status", document=text, retained=retained)
    if rest.startswith("thumbnail/"):
        return _thumbnail(vehicle, rest.split("/"), payload)
    document: Any = None
    if payload:
        try:
            document = json.loads(payload, parse_constant=_no_constant)
        except (ValueError, RecursionError):
            return None
    if rest in _KINDS:
        if document is not None and not isinstance(document, dict):
            return None
        return Document(vehicle=vehicle, kind=rest, document=document, retained=retained)
    command = rest.removeprefix("response/")
    if command != rest and "/" not in command and isinstance(document, dict):
        return Response(vehicle=vehicle, command=command, document=document)
    return None


def _no_constant(name: str) -> object:
    raise ValueError(f"{name} is not JSON")


def _thumbnail(vehicle: str, levels: list[str], payload: bytes) -> Thumbnail | None:
    if len(levels) != 3 or not is_mission(levels[1]) or not levels[2].isdecimal() or len(levels[2]) > 6:
        return None
    if not payload.startswith(b"\xff\xd8") or len(payload) > MAX_THUMBNAIL:
        return None
    return Thumbnail(vehicle=vehicle, mission_id=levels[1], shot=int(levels[2]), jpeg=payload)
