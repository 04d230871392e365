"""The last photo command of a camera, by which retransmissions are recognised."""

from __future__ import annotations

from dataclasses import dataclass

from panoexec.sim.mavlink.component import Command

_RETRANSMISSION_S = 0.8
"""Wall time within which a repeated command counts as a retransmission; MAVSDK retransmits after 0.5 s."""
_RETRANSMISSIONS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoCommand:
    """The last photo command and its acknowledgement (None = none sent)."""

    command: Command
    sent_s: float
    result: int | None
    repeats: int = 0

    def is_repeated_by(self, other: Command, wall_s: float) -> bool:
        """Whether another command is a retransmission of this one.

        A retransmission increments `confirmation`. MAVSDK's does not; it is recognised by its sequence number (param4)
        and by arriving soon after a command that was not acknowledged.
        """
        same = other.sender == self.command.sender and other.params == self.command.params
        if not same or wall_s > _RETRANSMISSION_S or self.repeats >= _RETRANSMISSIONS:
            return False
        return other.confirmation > 0 or self.result is None
