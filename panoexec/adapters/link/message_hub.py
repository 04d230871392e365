"""Dispatches MAVLink messages by name from MAVSDK's callback thread to handlers.

Handlers run in MAVSDK's thread and must be quick: MAVSDK queues at most 100 callbacks and drops further ones. For this
reason, and because they wake the event loop for each message, the generators of `mavsdk.asyncio` are not used.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import structlog
from mavsdk.plugins.mavlink_direct import MavlinkDirect

from panoexec.adapters.link.thread_state import keep_thread_state
from panoexec.clock import Clock

_log = structlog.get_logger(__name__)


class MavMessage:
    """One message.

    Attributes:
        name: MAVLink message name.
        system_id, component_id: the sender's ids; 0 is a system that was not told.
        received_s: when it arrived, on the mission's clock.
        heard_s: when it arrived, on the real monotonic clock.
    """

    __slots__ = ("_fields", "component_id", "heard_s", "name", "received_s", "system_id")

    def __init__(
        self, name: str, component_id: int, fields: dict[str, Any] | str, received_s: float, *, system_id: int = 0
    ) -> None:
        """Create it from a received message.

        Args:
            name: MAVLink message name.
            component_id: the sender's component.
            fields: by MAVLink's field names, or their JSON text.
            received_s: when it arrived, on the mission's clock.
            system_id: the sender's system.
        """
        self.name = name
        self.system_id = system_id
        self.component_id = component_id
        self.received_s = received_s
        self.heard_s = time.monotonic()
        self._fields = fields

    @property
    def fields(self) -> dict[str, Any]:
        """The fields by MAVLink's names; NaN is None, as JSON has no NaN. Parsed at the first access.

        Raises:
            ValueError: invalid JSON.
        """
        if isinstance(self._fields, str):
            self._fields = json.loads(self._fields)
        return self._fields  # type: ignore[return-value]

    def unusable(self, error: Exception) -> None:
        """Log that the message has invalid fields."""
        _log.warning("invalid message", name=self.name, error=repr(error), fields=self._fields)


Handler: TypeAlias = Callable[[MavMessage], None]


class MessageHub:
    """Dispatches messages of one system to handlers; outlives connections and is attached to the current one.

    What other systems send never reaches a handler. MAVSDK sorts messages by system too (measured with 4.1: a
    subscription gets those of its `System` alone), but a report that proves a photo does not depend on that.
    """

    def __init__(
        self,
        clock: Clock,
        post: Callable[..., None],
        *,
        mute: Callable[[str, bool], None] = lambda _name, _datagram_filter: None,
    ) -> None:
        """Create it.

        Args:
            clock: of the mission.
            post: schedules a callback on the event loop from another thread.
            mute: called on the loop with a message name and whether its messages are currently not needed.
        """
        self._clock = clock
        self._post = post
        self._mute = mute
        self._handlers: dict[str, tuple[Handler, ...]] = {}
        self._direct: MavlinkDirect | None = None
        self._system = 0
        self._subscriptions: dict[str, Any] = {}
        self._throttled: frozenset[str] = frozenset()
        self._screens: dict[str, Handler] = {}

    def screen(self, name: str, check: Handler) -> None:
        """Pass each message of that name to `check` before any handler gets it; it may change the fields."""
        self._screens[name] = check

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        """Call `handler` with each message of that name, in MAVSDK's thread.

        Returns:
            A function that unsubscribes it; may be called twice.
        """
        known = self._handlers.get(name)
        self._handlers[name] = (*(known or ()), handler)
        if known is None and self._direct is not None:
            self._subscribe(name)

        def off() -> None:
            self._handlers[name] = tuple(h for h in self._handlers[name] if h is not handler)

        return off

    def attach(self, direct: MavlinkDirect, system_id: int) -> None:
        """Subscribe to all messages that have handlers, of that system."""
        self._direct = direct
        self._system = system_id
        for name in self._handlers:
            self._subscribe(name)

    def detach(self) -> None:
        """Detach from the connection, which ends its subscriptions itself."""
        self._direct = None
        self._subscriptions.clear()

    def throttle(self, names: Iterable[str]) -> None:
        """Receive only the first of these messages after each `listen_again`, until this is called again.

        A gimbal with its own MAVLink component sends 50 reports a second, requested or not, and each report that
        reaches Python takes 0.2 ms on a small computer: too much for an idle daemon.
        """
        self._throttled = frozenset(names)
        self.listen_again()

    def listen_again(self) -> None:
        """Subscribe again to throttled messages."""
        if self._direct is not None:
            for name in self._handlers:
                if name not in self._subscriptions:
                    self._mute(name, False)
                    self._subscribe(name)

    def _subscribe(self, name: str) -> None:
        def arrived(message: Any, _user_data: object) -> None:
            keep_thread_state()
            if message.system_id != self._system:
                return
            received = MavMessage(
                name,
                message.component_id,
                message.fields_json,
                self._clock.monotonic(),
                system_id=message.system_id,
            )
            if name in self._throttled:
                self._post(self._pause, name)
            try:
                if name in self._screens:
                    self._screens[name](received)
                for handler in self._handlers[name]:
                    handler(received)
            except (LookupError, TypeError, ValueError) as error:
                received.unusable(error)

        if self._direct is not None:
            self._subscriptions[name] = self._direct.subscribe_message(name, arrived)

    def _pause(self, name: str) -> None:
        if self._direct is not None and name in self._throttled and name in self._subscriptions:
            self._direct.unsubscribe_message(self._subscriptions.pop(name))
            self._mute(name, True)
