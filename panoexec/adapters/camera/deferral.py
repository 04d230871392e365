"""How long a trigger may still be carried out after it was answered, and whether its photo has to be reported.

ArduPilot keeps a trigger that comes sooner than CAM1_INTRVAL_MIN after the last one and carries it out later, whether
it answered ACCEPTED or FAILED; a camera may have a queue of its own. Nothing may move until that has happened, or
cannot happen any more.
"""

from __future__ import annotations

from typing import Final

from panoexec.adapters.camera.capture_matching import CaptureMatcher
from panoexec.adapters.link.mavsdk_link import MavsdkLink

_SLACK_S: Final = 0.5
_LONGEST_S: Final = 7.0
"""Nothing is deferred for longer than this; a trigger call of the mission ends after 10 s."""
_UNTOLD_S: Final = 5.0
"""How long a trigger may be deferred by an autopilot whose least interval could not be read."""
_VAIN_WAITS: Final = 2
_UNDATED_S: Final = 3.0
"""How long the report of a camera that does not date its photos is waited for: it was exposed before it."""


class Deferral:
    """What is known of one camera's deferred triggers.

    Attributes:
        by_autopilot: the autopilot triggers it.
        told_s: the autopilot's least interval between triggers; None where it could not be read.
        reports: reports of the autopilot's triggers that came.
        vain_waits: how often a refused or unanswered trigger was waited for in vain.
    """

    def __init__(self, matcher: CaptureMatcher) -> None:
        self._matcher = matcher
        self.by_autopilot = False
        self.told_s: float | None = 0.0
        self.reports = self.vain_waits = 0

    def may_defer_s(self, *, is_first: bool, clock_is_related: bool) -> float:
        """How long after the next trigger it may be carried out unseen, unless it is reported.

        Args:
            is_first: it is the first trigger.
            clock_is_related: the camera's stamps can be dated.
        """
        if self.by_autopilot:
            if self.told_s is not None:
                return min(self.told_s + _SLACK_S, _LONGEST_S) if self.told_s > 0 else 0.0
            silent = not is_first and not self.reports  # then no report would end the wait
            return 0.0 if silent or self.vain_waits >= _VAIN_WAITS else _UNTOLD_S
        if not self._matcher.dated_photos and (self._matcher.undated_photos or not clock_is_related):
            return _UNDATED_S
        late_s = self._matcher.refused_taken_after_s
        return min(late_s + _SLACK_S, _LONGEST_S) if late_s else 0.0

    @property
    def must_report(self) -> bool:
        """Whether the next photo has to be reported, because earlier ones were."""
        if self.by_autopilot:
            return self.reports > 0
        return self._matcher.dated_photos + self._matcher.undated_photos > 0


async def least_interval_s(link: MavsdkLink, *, own_trigger: bool) -> float | None:
    """The autopilot's least interval between triggers, by its parameters; None where that cannot be read.

    Args:
        link: to the autopilot.
        own_trigger: it is PX4's own trigger.
    """
    read = link.requests.parameter
    if own_trigger:
        interval_ms = await read("TRIG_INTERVAL")
        return 0.0 if interval_ms is None else interval_ms / 1000.0
    return await read("CAM1_INTRVAL_MIN") if link.is_ardupilot else 0.0


async def has_feedback_pin(link: MavsdkLink, *, own_trigger: bool) -> bool:
    """Whether a hot-shoe is wired to the autopilot, which then reports that the shutter opened."""
    if own_trigger:
        return (await link.requests.parameter("CAM_CAP_FBACK") or 0) == 1
    return link.is_ardupilot and (await link.requests.parameter("CAM1_FEEDBAK_PIN") or -1) > 0
