"""What all events of a mission have, and the values that several of them carry (`panoexec.mission.log.events`)."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, ClassVar

from panoexec.codec import ByName, Number, Whole, encode
from panoexec.devices import EvidenceLevel
from panoexec.mission.log.states import MissionState

NAN = math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisErrors:
    """The largest pointing errors of an exposure, signed, in degrees (`planning.geometry.pose_error`)."""

    pitch_deg: Number
    roll_deg: Number
    yaw_deg: Number
    across_deg: Number
    along_deg: Number
    rotation_deg: Number
    boresight_deg: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPose:
    """The mean attitude over an exposure, in the plan's frame."""

    q_wxyz: tuple[Number, Number, Number, Number]
    roll_deg: Number
    pitch_deg: Number
    yaw_deg: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class Photo:
    """The record of one photo.

    Attributes:
        number: within its attempt, from 1 (brackets have several).
        evidence: the best evidence so far.
        capture_time_utc_s: exposure time as reported by the camera, else the time of the trigger.
        image_index: the camera's image index, or -1.
        file: file name or URL as reported by the camera, or "".
        latitude_deg, longitude_deg, altitude_m: position, or NaN.
        duplicates: further reports of the same photo.
    """

    number: Whole
    evidence: Annotated[EvidenceLevel, ByName()]
    capture_time_utc_s: Number
    image_index: Whole = -1
    file: str = ""
    latitude_deg: Number = NAN
    longitude_deg: Number = NAN
    altitude_m: Number = NAN
    duplicates: Whole = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """The common fields of all events, set by the recorder.

    Attributes:
        mission_id: the mission.
        seq: 1, 2, 3, … within the mission.
        time_utc_s: wall time.
        clock_s: the mission's clock, seconds (in a dry-run: the simulated vehicle's); differences within one process
            are durations that do not depend on wall time. NaN if unknown.
        state: the mission's state after the event.
    """

    mission_id: str = ""
    seq: Whole = 0
    time_utc_s: Number = 0.0
    clock_s: Number = NAN
    state: MissionState = MissionState.IDLE

    type: ClassVar[str] = "event"

    def __init_subclass__(cls) -> None:
        cls.type = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    def to_json(self) -> dict[str, Any]:
        """A JSON object: `type`, `id`, `time` (ISO 8601 UTC) and the fields; NaN becomes null."""
        stamp = datetime.fromtimestamp(self.time_utc_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        head = {"type": self.type, "id": f"{self.mission_id}/{self.seq}", "time": stamp}
        return head | encode(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotEvent(Event):
    """Common fields of the events of one attempt at a shot; attempts count from 1 across rounds and restarts."""

    shot: Whole
    attempt: Whole
