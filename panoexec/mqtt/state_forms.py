"""In which form a state leaves: whole, or on a slow link as the difference from the last whole one."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from panoexec.mqtt.messages import dump_json
from panoexec.mqtt.outbox import Outgoing
from panoexec.mqtt.state_deltas import Document, delta_payload
from panoexec.mqtt.topics import Topics

WHOLE_S: Final = 30.0
"""So often a whole state leaves on a slow link; another daemon must hear one within `twin.TWIN_S`."""

_AT_ONCE: Final = ("state", "mission_id", "resumable", "reason")
"""A change of these is worth a whole state, so that whoever reads the retained topic alone knows it at once."""

_SMALLER: Final = 0.75
"""The payload of a delta is at most this part of that of the whole state."""


class StateForms:
    """Makes the forms of states; the same message gets the same ones until the broker has another whole state.

    Attributes:
        allowed: whether deltas may be sent over this connection.
    """

    def __init__(self, topics: Topics, *, clock: Callable[[], float] = time.monotonic) -> None:
        """Describe it.

        Args:
            topics: of the vehicle.
            clock: monotonic seconds.
        """
        self.allowed = False
        self._topics = topics
        self._clock = clock
        self._refused = False
        self._whole_s = -math.inf
        self._made: tuple[Outgoing | None, bytes | None, tuple[Outgoing, Outgoing | None, bool]] | None = None

    def connected(self, *, may: bool) -> None:
        """Begin with a connection.

        Args:
            may: whether its broker keeps whole states and tells which messages it refuses.
        """
        self.allowed = may and not self._refused
        self._made = None

    def refuse(self) -> None:
        """The broker does not take deltas: send whole states from now on."""
        self._refused = True
        self.allowed = False

    def sent(self, message: Outgoing) -> None:
        """Note that the broker has a message."""
        if message.topic == self._topics.state:
            self._whole_s = self._clock()

    def of(self, message: Outgoing, *, held: bytes | None, slow: bool) -> tuple[Outgoing, ...]:
        """The forms of a message of a retained topic, the best one first.

        Args:
            message: as it was published; a state is what `messages.dump` makes of one.
            held: the payload of this topic that the broker has acknowledged on this connection; None for none.
            slow: whether the link is slow.
        """
        if message.topic != self._topics.state or not slow or not self.allowed:
            return (message,)
        if self._made is None or self._made[0] is not message or self._made[1] != held:
            self._made = (message, held, self._forms(message, held))
        whole, delta, better = self._made[2]
        if delta is None:
            return (whole,)
        return (whole, delta) if not better or self._clock() - self._whole_s >= WHOLE_S else (delta,)

    def _forms(self, message: Outgoing, held: bytes | None) -> tuple[Outgoing, Outgoing | None, bool]:
        """Whole, as a delta if there can be one, and whether that is better."""
        state = _coarse(json.loads(message.payload))
        whole = replace(message, payload=dump_json(state), stands_for=message)
        base = None if held is None else json.loads(held)
        payload = None if base is None else delta_payload(base, state)
        if base is None or payload is None:
            return whole, None, False
        delta = Outgoing(topic=self._topics.state_delta, payload=payload, stands_for=message)
        known = all(base[key] == state[key] for key in _AT_ONCE)
        return whole, delta, known and len(delta.payload) <= _SMALLER * len(whole.payload)


def _coarse(state: Document) -> Document:
    """A state with whole seconds since the last message of each link, and a pose in whole degrees without its error.

    They then seldom change, and say as much as a state that is seconds old can.
    """
    links = {
        name: link | {"age_s": math.floor(link["age_s"]) if link["age_s"] is not None else None}
        for name, link in state["link"].items()
    }
    pose = state["pose"]
    if pose is not None:
        pose = {name: None if name == "error_deg" else round(value) for name, value in pose.items()}
    return state | {"link": links, "pose": pose}
