"""A link that drops messages while the vehicle says so."""

from __future__ import annotations

from collections.abc import Callable

from panoexec.sim.mavlink.wire import Link, Message


class GatedLink:
    """A link of the vehicle that drops all messages during a reboot or a link loss.

    Args:
        link: where the others are sent.
        drops: whether nothing is sent on a link now.
    """

    def __init__(self, link: Link, drops: Callable[[Link], bool]) -> None:
        self.name = link.name
        self._link = link
        self._drops = drops

    def send(self, frame: bytes, message: Message) -> None:
        """See `Link.send`."""
        if not self._drops(self._link):
            self._link.send(frame, message)
