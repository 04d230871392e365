"""The events of a mission: stored in the journal, folded into the mission's record and published to consumers.

An event carries its mission's id and a sequence number `seq` that continues across restarts of the process, so
consumers can drop duplicates by `mission_id` and `seq`; events of a shot also carry the shot's index and the number of
the attempt. An event is published only after the journal has stored it.

Angles of attitudes are in the plan's frame: yaw 0 is the plan's reference direction. Quaternions are `[w, x, y, z]`,
camera (FRD) to that frame (NED); roll, pitch and yaw are the gimbal's axes in 3-1-2 order (`panoexec.angles`).
"""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from panoexec.codec import Flag, Number, Whole, decode
from panoexec.mission.log.event_base import NAN, AxisErrors, Event, MeasuredPose, Photo, ShotEvent
from panoexec.mission.log.photo_events import (
    BridgePlanned,
    ContentJudged,
    PhotoChecked,
    PhotoIdentified,
    PhotoStored,
    PhotoTie,
)

__all__ = [
    "EVENT_TYPES",
    "NAN",
    "AxisErrors",
    "BridgePlanned",
    "CommandReceived",
    "ContentJudged",
    "Event",
    "EventSink",
    "GimbalAcquired",
    "GimbalContradicted",
    "GimbalReleased",
    "MeasuredPose",
    "MissionAnchored",
    "MissionFinished",
    "MissionFinishing",
    "MissionPaused",
    "MissionResumed",
    "MissionStarted",
    "PatchPlanned",
    "Photo",
    "PhotoChecked",
    "PhotoIdentified",
    "PhotoStored",
    "PhotoTie",
    "PreflightFailed",
    "PreflightPassed",
    "ShotAccepted",
    "ShotDeferred",
    "ShotEvent",
    "ShotExposed",
    "ShotInterrupted",
    "ShotMissed",
    "ShotRejected",
    "ShotRetaken",
    "ShotRevoked",
    "ShotSkipped",
    "ShotStarted",
    "UnknownEventError",
    "Warned",
    "event_from_json",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionStarted(Event):
    """The mission begins, or continues in a new process (`resumed`); preflight checks follow."""

    shots_total: Whole
    resumed: Flag = False
    reference: str = "north"
    """What yaw 0 means: `north` or `heading`."""
    reference_yaw_north_deg: Number = 0.0
    """Direction of the plan's yaw 0, clockwise from true north."""
    latitude_deg: Number = NAN
    longitude_deg: Number = NAN
    altitude_m: Number = NAN
    """Above mean sea level."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionAnchored(Event):
    """Position or heading of the vehicle became known after the start of the process."""

    reference_yaw_north_deg: Number = NAN
    """Direction of the plan's yaw 0, clockwise from true north; holds if none was known."""
    latitude_deg: Number = NAN
    longitude_deg: Number = NAN
    altitude_m: Number = NAN
    """Above mean sea level."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PreflightPassed(Event):
    """All preflight checks passed; shooting begins."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PreflightFailed(Event):
    """Preflight checks failed; the mission does not begin."""

    problems: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReceived(Event):
    """A command to the running mission was accepted.

    Attributes:
        command: its name.
        shot: the shot that it is about, if any.
        reason: given with it.
        by: who sent it, as the sender says; "" if unknown.
    """

    command: str
    shot: Whole | None = None
    reason: str = ""
    by: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Warned(Event):
    """A warning for the pilot; the mission continues."""

    code: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalAcquired(Event):
    """The gimbal manager confirmed panoexec as primary control.

    Attributes:
        manager: MAVLink component of the manager; 0 if unknown.
        device: MAVLink component whose attitude counts; 0 if unknown.
        device_id: its gimbal device id.
        feedback: kind of its reports: `earth`, `vehicle`, `body`, `none`; "" if unknown.
    """

    manager: Whole = 0
    device: Whole = 0
    device_id: Whole = 0
    feedback: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalContradicted(Event):
    """Gimbal and autopilot contradict each other about the vehicle's heading by more than the yaw tolerance.

    Attributes:
        north_off_deg: heading as the gimbal tells it minus that of the autopilot.
        corrected: the gimbal's reports are corrected by it.
        text: for the pilot.
    """

    north_off_deg: Number
    corrected: Flag
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalReleased(Event):
    """Control of the gimbal was released (`confirmed` is false if the gimbal did not confirm it in time)."""

    confirmed: Flag = True


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionPaused(Event):
    """Shooting is paused.

    Attributes:
        code: the guard or command that paused it.
        reason: for the pilot.
        automatic: continues by itself when the cause is gone; else it waits for `resume`.
    """

    code: str
    reason: str
    automatic: Flag = False


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionResumed(Event):
    """Shooting continues after a pause of `paused_s`."""

    paused_s: Number
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionFinishing(Event):
    """No shots are left, or a command accepted the gaps."""

    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchPlanned(Event):
    """Shots were added to close holes of the measured attitudes."""

    shots: tuple[Whole, ...]
    rows: tuple[Whole, ...]
    """The row of each that it belongs to, -1 for none."""
    pitch_deg: tuple[Number, ...]
    yaw_deg: tuple[Number, ...]
    holes: Whole
    largest_hole_deg: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionFinished(Event):
    """The mission ended: its state is complete, incomplete, aborted or failed.

    Attributes:
        reason: why it ended in this state.
        accepted: number of shots with an accepted photo.
        missing: indices of shots without one.
        certified: whether the measured attitudes pass the certificate; None if it was not computed.
    """

    reason: str
    accepted: Whole
    missing: tuple[Whole, ...]
    certified: Flag | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotStarted(ShotEvent):
    """The slew to a shot begins; on disk before its trigger is sent.

    Attributes:
        round: 0 in the first pass over the shots, then 1, 2, … for deferred shots.
        pitch_deg, yaw_deg: the target in the plan's frame.
        patience_s: settle timeout beyond the expected slew.
    """

    round: Whole
    pitch_deg: Number
    yaw_deg: Number
    patience_s: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotExposed(ShotEvent):
    """Photos were triggered and the attitudes of the exposure are judged; evidence may be outstanding.

    Attributes:
        photos: with the evidence so far.
        pointing_ok: the samples prove that the pose was inside tolerance; by which of them, see `proof`.
        reason: why not; of a pose that is proven by a part of them, what the others were like.
        samples: number of attitude samples judged.
        measured: mean attitude; None without usable samples.
        errors: the largest of each error of what was judged; None without usable samples.
        slew_settle_s: from the pointing command to settled.
        trigger_delay_s: from settled to the trigger command on the wire.
        open_loop: there is no attitude feedback; the pose is assumed.
        images_before: the camera's image count before the trigger; -1 if unknown.
        may_overlap: outside tolerance, but sharp: the overlaps decide.
        latitude_deg, longitude_deg: of the vehicle after the exposure; NaN if unknown.
        altitude_m: above mean sea level.
        height_m: above the place of take-off.
        proof: `samples`: every sample of the exposure window was inside tolerance; `opening`: every one while the
            shutter was open; `curve`: a curve through the samples was, while it was open, and `errors` are its errors;
            "": nothing is proven, or not told (journals of earlier versions).
    """

    photos: tuple[Photo, ...]
    pointing_ok: Flag
    reason: str
    samples: Whole
    measured: MeasuredPose | None
    errors: AxisErrors | None
    slew_settle_s: Number
    trigger_delay_s: Number
    open_loop: Flag = False
    images_before: Whole = -1
    may_overlap: Flag = False
    latitude_deg: Number = NAN
    longitude_deg: Number = NAN
    altitude_m: Number = NAN
    height_m: Number = NAN
    proof: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotAccepted(ShotEvent):
    """The attempt is accepted: pointing is verified and there is evidence of the photo.

    Attributes:
        photos: with the evidence that was decisive.
        by: `tolerance`, `overlap` (outside tolerance, but the certificate holds with the measured attitude) or
            `open_loop`.
    """

    photos: tuple[Photo, ...]
    by: str = "tolerance"


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotRejected(ShotEvent):
    """The attempt is rejected.

    Attributes:
        code: `not_settled`, `pointing`, `no_samples`, `trigger`, `evidence`, `late_exposure`, `gimbal`, `foreign`,
            `stale`, `vehicle`, `parallax`, `crash`.
        reason: for the pilot, with figures.
    """

    code: str
    reason: str
    photos: tuple[Photo, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotRevoked(ShotEvent):
    """An accepted attempt is rejected after all: what became known of its photos later contradicts it.

    Attributes:
        code: `evidence` or `late_exposure`, as for a rejected attempt; `echo`: the gimbal's reports repeat the command,
            so the pose was never verified.
        reason: for the pilot, with figures.
        photos: with the evidence that was decisive.
    """

    code: str
    reason: str
    photos: tuple[Photo, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotInterrupted(ShotEvent):
    """The attempt was interrupted before its photo; it does not count as an attempt."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotRetaken(ShotEvent):
    """The shot is taken again at once, as attempt number `attempt`."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotDeferred(ShotEvent):
    """The shot is taken again after the others; `attempt` was the last one."""

    reason: str
    round: Whole


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotMissed(ShotEvent):
    """All attempts are used up; the shot stays missing unless it is repeated or patched. Or a bridge ties nothing."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotSkipped(ShotEvent):
    """The shot was skipped by command."""

    reason: str = ""


class EventSink(Protocol):
    """Receives events after they were stored."""

    def publish(self, event: Event) -> None:
        """Take one event; must not block and must not raise."""
        ...


def _concrete(cls: type[Event]) -> dict[str, type[Event]]:
    out: dict[str, type[Event]] = {}
    for sub in cls.__subclasses__():
        out[sub.type] = sub
        out |= _concrete(sub)
    return out


EVENT_TYPES: Mapping[str, type[Event]] = types.MappingProxyType(
    {name: cls for name, cls in _concrete(Event).items() if name != "shot_event"}
)
"""All event classes by the `type` of their JSON."""


class UnknownEventError(ValueError):
    """An event of a type that this version does not know."""


def event_from_json(data: Mapping[str, Any]) -> Event:
    """Parse the JSON that `to_json` produced.

    Raises:
        UnknownEventError: an unknown type.
        ValueError: invalid fields.
    """
    cls = EVENT_TYPES.get(str(data.get("type"))) if isinstance(data, Mapping) else None
    if cls is None:
        raise UnknownEventError(f"unknown event type: {str(data)[:80]}")
    return decode(cls, data)
