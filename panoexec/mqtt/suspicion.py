"""Finding the message at which a broker closes the connection."""

from __future__ import annotations

from collections.abc import Sequence

from panoexec.mqtt.outbox import Outgoing


class Suspicion:
    """Finds a message that repeatedly makes the broker close the connection, for example because it is too large.

    After a connection has ended with several unacknowledged messages, messages are sent one by one. A message with
    which the connection ends `STRIKES` times in a row is identified as the cause.
    """

    STRIKES = 3

    def __init__(self) -> None:
        self.wary = False
        """Whether messages should be sent one by one."""
        self._suspect: Outgoing | None = None
        self._strikes = 0

    def ended(self, message: Outgoing, *, alone: bool) -> bool:
        """Record that the connection ended with this unacknowledged message; returns whether it is the cause."""
        self.wary = True
        if not alone:
            return False
        self._strikes = self._strikes + 1 if message is self._suspect else 1
        self._suspect = message
        return self._strikes >= self.STRIKES

    def acknowledged(self, messages: Sequence[Outgoing], *, left: int) -> None:
        """Record acknowledged messages and the number of messages that are still waiting."""
        if any(message is self._suspect for message in messages):
            self._suspect, self._strikes = None, 0
        if not left:
            self.wary = False
