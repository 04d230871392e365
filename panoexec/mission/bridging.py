"""Bridge shots of a mission: flown halfway between photos that share too little to be tied to each other.

A pair is bridged once, a mission at most `MOST_BRIDGES` times in `ROUNDS` rounds, across restarts too: all of it is in
the record. What the bridge ties, and what it does not, is told at the end.
"""

from __future__ import annotations

from typing import Final

from panoexec.mission.context import MissionContext
from panoexec.mission.log import events as ev
from panoexec.mission.measured_certificate import NO_ROW
from panoexec.mission.preflight import gimbal_limits
from panoexec.mission.protocols import PictureChecker
from panoexec.pictures.model import BridgePose
from panoexec.planning.model import Shot
from panoexec.planning.reach import reaches_yaw

MOST_BRIDGES: Final = 8
ROUNDS: Final = 2


class Bridging:
    """Plans the bridge shots of one mission.

    Args:
        context: the mission.
    """

    def __init__(self, context: MissionContext) -> None:
        self._context = context
        self._unreachable: set[frozenset[int]] = set()
        self._closed = False

    def may_help(self, shot: int) -> bool:
        """Whether a photo that is tied to nothing may still be bridged, rather than be taken again and again."""
        record = self._context.record
        bridged = any(shot in (one.between or ()) for one in record.shots.values())
        return not self._closed and not bridged and record.bridge_rounds < ROUNDS

    def close(self) -> bool:
        """No photo waits for a bridge any more; returns whether any could until now."""
        was_open, self._closed = not self._closed, True
        return was_open

    async def plan(self, checker: PictureChecker) -> bool:
        """Queue the bridge shots that are worth it, if any.

        Raises:
            PanoexecError: the examination failed.
        """
        context, record = self._context, self._context.record
        flown = [frozenset(shot.between) for shot in record.shots.values() if shot.between is not None]
        if record.bridge_rounds >= ROUNDS or len(flown) >= MOST_BRIDGES:
            return False
        limits = gimbal_limits(context.gimbal, context.settings)
        poses: list[BridgePose] = []
        while not poses:
            wished = await checker.bridges(
                tried=[*flown, *self._unreachable],
                pitch_deg=(limits.pitch_min_deg, limits.pitch_max_deg),
                most=MOST_BRIDGES - len(flown),
            )
            if not wished:
                return False
            poses = [one for one in wished if reaches_yaw(limits, one.yaw_deg)]
            self._unreachable |= {frozenset(one.between) for one in wished if one not in poses}
        shots = record.renumbered(
            [Shot(index=0, row=NO_ROW, pitch_deg=one.pitch_deg, yaw_deg=one.yaw_deg) for one in poses]
        )
        context.recorder.emit(
            ev.BridgePlanned(
                shots=tuple(shot.index for shot in shots),
                between=tuple(shot for one in poses for shot in one.between),
                pitch_deg=tuple(shot.pitch_deg for shot in shots),
                yaw_deg=tuple(shot.yaw_deg for shot in shots),
            )
        )
        for shot in shots:
            context.queue.add(shot.index)
        return True

    def tell(self) -> None:
        """Warn of the pairs that a bridge has not tied."""
        record = self._context.record
        for shot, tied in record.bridge_ties().items():
            between = record.shots[shot].between
            assert between is not None
            loose = [end for end in between if end not in tied]
            if loose:
                a, b = between
                ties = f"shot {tied[0]} alone" if tied else "neither of them"
                text = f"shots {a} and {b} show texture but share too little; bridge shot {shot} ties {ties}"
                if text not in record.warnings:
                    self._context.recorder.emit(ev.Warned(code="untied", text=text))
