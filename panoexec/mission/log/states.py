"""Mission states and the table of legal transitions; drawn and explained in docs/mission.md.

`idle` is a mission that was not started in this process; a mission that is resumed after a crash or a stop of the
process starts there again. Every mission that leaves another state for good has released the gimbal and closed its
journal.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType

from panoexec.errors import MissionError


class MissionState(StrEnum):
    """Where a mission is (docs/contract.md, docs/mission.md)."""

    IDLE = "idle"
    """Not started in this process."""
    PREFLIGHT = "preflight"
    """Preflight checks run and the gimbal is acquired; nothing has moved."""
    CAPTURING = "capturing"
    """Shots are being taken."""
    PAUSED = "paused"
    """Paused for a stated reason, also by an interrupted process. Can be resumed."""
    FINISHING = "finishing"
    """The last evidence is awaited and the measured attitudes are certified."""
    COMPLETE = "complete"
    """Every shot was accepted, or the measured attitudes prove the panorama complete without the missing ones."""
    INCOMPLETE = "incomplete"
    """The mission ended normally, but shots that the panorama needs are missing."""
    ABORTED = "aborted"
    """Ended by an abort command."""
    FAILED = "failed"
    """Ended by a fault (device, link, battery); can be resumed when the cause is gone."""


_S = MissionState

TRANSITIONS: Mapping[MissionState, frozenset[MissionState]] = MappingProxyType(
    {
        # preflight is the first phase, also of a resumed mission
        _S.IDLE: frozenset({_S.PREFLIGHT}),
        # paused: by command, or the process stops; finishing: no shots are left, or by command
        _S.PREFLIGHT: frozenset({_S.CAPTURING, _S.PAUSED, _S.FINISHING, _S.ABORTED, _S.FAILED}),
        _S.CAPTURING: frozenset({_S.PAUSED, _S.FINISHING, _S.ABORTED, _S.FAILED}),
        _S.PAUSED: frozenset({_S.CAPTURING, _S.FINISHING, _S.ABORTED, _S.FAILED}),
        # capturing: patches or a repeat; paused: the process stops
        _S.FINISHING: frozenset({_S.CAPTURING, _S.PAUSED, _S.COMPLETE, _S.INCOMPLETE, _S.ABORTED, _S.FAILED}),
        # ended: the next mission, or this one resumed, begins at idle
        _S.COMPLETE: frozenset({_S.IDLE}),
        _S.INCOMPLETE: frozenset({_S.IDLE}),
        _S.ABORTED: frozenset({_S.IDLE}),
        _S.FAILED: frozenset({_S.IDLE}),
    }
)
"""From each state, the states that may follow it."""

ENDED: frozenset[MissionState] = frozenset({_S.COMPLETE, _S.INCOMPLETE, _S.ABORTED, _S.FAILED})
"""States in which the mission has ended."""

FINISHED: frozenset[MissionState] = frozenset({_S.COMPLETE, _S.INCOMPLETE, _S.ABORTED})
"""Ended states from which a mission cannot be resumed."""


class IllegalTransitionError(MissionError):
    """A transition that the table does not allow: a bug in panoexec, never an operator's error."""


def check_transition(old: MissionState, new: MissionState) -> None:
    """Raise unless `new` may follow `old`.

    Raises:
        IllegalTransitionError: it may not; the message names both states and the legal ones.
    """
    if new not in TRANSITIONS[old]:
        legal = ", ".join(sorted(TRANSITIONS[old]))
        raise IllegalTransitionError(f"a mission cannot go from {old} to {new}; from {old}: {legal}")
