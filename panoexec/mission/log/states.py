"""Mission states and the one table of legal transitions; drawn and explained in docs/mission.md.

`idle` is a mission that was not started in this process; one that is resumed after a crash or a stop of the process
starts there again. From every other state the way out is short, and every way out ends with the gimbal released and
the journal closed.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType

from panoexec.errors import MissionError


class MissionState(StrEnum):
    """Where a mission is (docs/contract.md, docs/mission.md)."""

    IDLE = "idle"
    """Nothing has begun in this process."""
    PREFLIGHT = "preflight"
    """Everything is checked, control of the gimbal is taken; nothing has moved."""
    CAPTURING = "capturing"
    """Shots are being taken."""
    PAUSED = "paused"
    """Paused, for a reason that is stated; also what an interrupted process leaves behind. Can be resumed."""
    FINISHING = "finishing"
    """The last evidence is awaited, the panorama as flown is certified."""
    COMPLETE = "complete"
    """Every shot was accepted, or the measured attitudes prove the panorama complete without the missing ones."""
    INCOMPLETE = "incomplete"
    """The mission ended in order with shots missing that the panorama needs."""
    ABORTED = "aborted"
    """Somebody said stop."""
    FAILED = "failed"
    """The mission could not go on (device, link, battery); it can be resumed when the cause is gone."""


_S = MissionState

TRANSITIONS: Mapping[MissionState, frozenset[MissionState]] = MappingProxyType(
    {
        # the process ends, or the mission is called off, before anything was checked
        _S.IDLE: frozenset({_S.PREFLIGHT}),
        # paused: asked to, or the process is stopped; finishing: nothing is left to shoot, or asked to
        _S.PREFLIGHT: frozenset({_S.CAPTURING, _S.PAUSED, _S.FINISHING, _S.ABORTED, _S.FAILED}),
        _S.CAPTURING: frozenset({_S.PAUSED, _S.FINISHING, _S.ABORTED, _S.FAILED}),
        _S.PAUSED: frozenset({_S.CAPTURING, _S.FINISHING, _S.ABORTED, _S.FAILED}),
        # capturing: a hole was found, or a repeat was asked for; paused: the process is stopped
        _S.FINISHING: frozenset({_S.CAPTURING, _S.PAUSED, _S.COMPLETE, _S.INCOMPLETE, _S.ABORTED, _S.FAILED}),
        # ended: what comes next is another mission, or this one resumed, and both begin at idle
        _S.COMPLETE: frozenset({_S.IDLE}),
        _S.INCOMPLETE: frozenset({_S.IDLE}),
        _S.ABORTED: frozenset({_S.IDLE}),
        _S.FAILED: frozenset({_S.IDLE}),
    }
)
"""From each state, the states that may follow it."""

ENDED: frozenset[MissionState] = frozenset({_S.COMPLETE, _S.INCOMPLETE, _S.ABORTED, _S.FAILED})
"""States in which nothing happens any more."""

FINISHED: frozenset[MissionState] = frozenset({_S.COMPLETE, _S.INCOMPLETE, _S.ABORTED})
"""States of missions that are over for good: they cannot be resumed."""


class IllegalTransitionError(MissionError):
    """A step that the table does not allow: a fault in panoexec, never a pilot's."""


def check_transition(old: MissionState, new: MissionState) -> None:
    """Raise unless `new` may follow `old`.

    Raises:
        IllegalTransitionError: it may not; the message names both and what would be legal.
    """
    if new not in TRANSITIONS[old]:
        legal = ", ".join(sorted(TRANSITIONS[old]))
        raise IllegalTransitionError(f"a mission cannot go from {old} to {new}; from {old}: {legal}")
