"""A stream of messages that is held up on its way, by the fault `attitude-late`."""

from __future__ import annotations

from collections import deque
from typing import Final

from panoexec.sim.faults import Faults
from panoexec.sim.mavlink.wire import Message

NAME: Final = "attitude-late"


class HeldUp:
    """Delays the messages of one stream while the fault is active; what is left then is lost.

    Args:
        faults: of the simulation.
    """

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._waiting: deque[tuple[float, Message]] = deque()

    def passed(self, message: Message | None, now_s: float) -> Message | None:
        """The message that arrives when this one is sent; None if none does.

        Args:
            message: built now; None: there is none.
            now_s: simulation time.
        """
        if not self._faults.active(NAME, now_s):
            self._waiting.clear()
            return message
        if message is not None:
            self._waiting.append((now_s + self._faults.size(NAME), message))
        return self._waiting.popleft()[1] if self._waiting and self._waiting[0][0] <= now_s else None
