"""MAVLink messages by name, from MAVSDK's callback thread to whoever asked for them.

Handlers run in the vendor's thread and must be quick: MAVSDK queues at most 100 callbacks and drops what comes then.
That, and that `mavsdk.asyncio` wakes the event loop once for each message, is why its generators are not used here.
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
        name: MAVLink's name of it.
        component_id: the sender's.
        received_s: when it arrived, on the mission's clock.
        heard_s: the same moment, by the real clock.
    """

    __slots__ = ("_fields", "component_id", "heard_s", "name", "received_s")

    def __init__(self, name: str, component_id: int, fields: dict[str, Any] | str, received_s: float) -> None:
        """Take it as it came.

        Args:
            name: MAVLink's.
            component_id: the sender's.
            fields: by MAVLink's names, or the JSON text of that.
            received_s: when it arrived, on the mission's clock.
        """
        self.name = name
        self.component_id = component_id
        self.received_s = received_s
        self.heard_s = time.monotonic()
        self._fields = fields

    @property
    def fields(self) -> dict[str, Any]:
        """By MAVLink's names; NaN is None, as JSON has no NaN. Parsed when first asked for: many never are.

        Raises:
            ValueError: it is not JSON.
        """
        if isinstance(self._fields, str):
            self._fields = json.loads(self._fields)
        return self._fields  # type: ignore[return-value]

    def unusable(self, error: Exception) -> None:
        """Tell that it does not say what it should."""
        _log.warning("unusable message", name=self.name, error=repr(error), fields=self._fields)


Handler: TypeAlias = Callable[[MavMessage], None]


class MessageHub:
    """Fans messages out to handlers; outlives the connection, to which it is attached when there is one."""

    def __init__(
        self, clock: Clock, post: Callable[..., None], *, mute: Callable[[str, bool], None] = lambda _name, _datagram_filter: None
    ) -> None:
        """Describe it.

        Args:
            clock: of the mission.
            post: calls a function on the event loop from another thread.
            mute: told, on the loop, that nobody needs the next messages of a name, or that somebody does again.
        """
        self._clock = clock
        self._post = post
        self._mute = mute
        self._handlers: dict[str, tuple[Handler, ...]] = {}
        self._direct: MavlinkDirect | None = None
        self._subscriptions: dict[str, Any] = {}
        self._throttled: frozenset[str] = frozenset()

    def on(self, name: str, handler: Handler) -> Callable[[], None]:
        """Call `handler` with each message of that name, in the vendor's thread.

        Returns:
            What ends it; harmless to call twice.
        """
        known = self._handlers.get(name)
        self._handlers[name] = (*(known or ()), handler)
        if known is None and self._direct is not None:
            self._subscribe(name)

        def off() -> None:
            self._handlers[name] = tuple(h for h in self._handlers[name] if h is not handler)

        return off

    def attach(self, direct: MavlinkDirect) -> None:
        """Subscribe to everything that handlers wait for."""
        self._direct = direct
        for name in self._handlers:
            self._subscribe(name)

    def detach(self) -> None:
        """Forget the connection, which ends its subscriptions itself."""
        self._direct = None
        self._subscriptions.clear()

    def throttle(self, names: Iterable[str]) -> None:
        """Hear only the first of these messages after each `listen_again`, until called anew.

        A gimbal that is its own component reports 50 times a second, asked or not, and each report that reaches Python
        costs 0.2 ms of a small computer: too much for a daemon that waits for hours.
        """
        self._throttled = frozenset(names)
        self.listen_again()

    def listen_again(self) -> None:
        """Hear what was throttled."""
        if self._direct is not None:
            for name in self._handlers:
                if name not in self._subscriptions:
                    self._mute(name, False)
                    self._subscribe(name)

    def _subscribe(self, name: str) -> None:
        def arrived(message: Any, _user_data: object) -> None:
            received = MavMessage(name, message.component_id, message.fields_json, self._clock.monotonic())
            keep_thread_state()
            if name in self._throttled:
                self._post(self._pause, name)
            try:
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
