"""The interfaces of a gimbal, a camera and a vehicle that the executor uses.

Adapters implement these protocols (`panoexec.adapters`); the executor and the tests use nothing else. All times named
`*_s` are seconds of the mission's `Clock.monotonic`, stamped by the adapter when a message arrives; times named
`*_vehicle_s` or `vehicle_s` are seconds since boot on the sender's clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Protocol, TypeAlias

from panoexec.planning.model import GimbalLimits

Quaternion: TypeAlias = tuple[float, float, float, float]
"""`[w, x, y, z]`, from the body's frame (FRD) to the frame stated with it."""


class YawFrame(StrEnum):
    """The reference frame of a gimbal's attitude."""

    EARTH = "earth"
    """Camera to world (NED, yaw from true north)."""
    VEHICLE = "vehicle"
    """Yaw from the vehicle's heading, roll and pitch from the horizon (MAVLink's YAW_IN_VEHICLE_FRAME)."""
    BODY = "body"
    """Relative to the vehicle's airframe in all three axes (a servo mount that reports its commanded servo angles)."""


@dataclass(frozen=True, slots=True)
class AttitudeSample:
    """One attitude report of the gimbal. Values may be NaN if the device reports so: they are never within tolerance.

    Attributes:
        received_s: when it arrived, without jitter if the sender stamps its messages: never later than the arrival.
        vehicle_s: when it was measured, the sender's boot time; NaN if unknown.
        q_wxyz: camera (FRD) to the frame of `yaw_frame`.
        yaw_frame: the reference frame of the attitude.
        rate_deg_s: magnitude of the angular velocity; NaN if unknown.
        failure_flags: the device's own errors (GIMBAL_DEVICE_ERROR_FLAGS), 0 = none.
        axis_rates_deg_s: of pitch, roll and yaw, relative to the earth; NaN if unknown.
    """

    received_s: float
    vehicle_s: float
    q_wxyz: Quaternion
    yaw_frame: YawFrame
    rate_deg_s: float
    failure_flags: int = 0
    axis_rates_deg_s: tuple[float, float, float] = (float("nan"), float("nan"), float("nan"))


@dataclass(frozen=True, slots=True)
class VehicleAttitude:
    """One attitude report of the airframe (FRD to world), to compose with a gimbal's relative attitude."""

    received_s: float
    vehicle_s: float
    q_wxyz: Quaternion


class EvidenceLevel(IntEnum):
    """The level of evidence of a photo, weakest first."""

    COMMANDED = 0
    """The trigger was sent."""
    ACKNOWLEDGED = 1
    """The autopilot or the camera accepted it."""
    COUNTED = 2
    """CAMERA_FEEDBACK (180) at the trigger, or the image count in CAMERA_CAPTURE_STATUS (262) increased."""
    FEEDBACK_PIN = 3
    """CAMERA_FEEDBACK from a wired hot-shoe pin: the shutter opened."""
    CAPTURE_MESSAGE = 4
    """CAMERA_IMAGE_CAPTURED (263) from the camera itself, with success."""
    FILE_SEEN = 5
    """The image file exists."""


@dataclass(frozen=True, slots=True)
class CaptureEvidence:
    """The evidence of one photo; reports of the same photo are merged.

    Attributes:
        level: the best proof.
        received_s: when the best proof arrived.
        exposed_vehicle_s: start of the exposure on the sender's boot clock if told, else NaN.
        image_index: the camera's running number, or -1.
        file_url: where the camera says that the file is, or "".
        time_utc_s: wall time of the exposure if told, else NaN.
        latitude_deg, longitude_deg, altitude_m: position if told (altitude above mean sea level), else NaN.
        duplicates: how many further reports of the same photo were merged in.
        exposed_s: start of the exposure on the mission's clock if it can be told, else NaN.
        exposed_error_s: how far `exposed_s` may be wrong; NaN where it cannot be told.
        opened_s: between which times the camera stamped the opening of its shutter, where requests that it answered
            prove that (`CameraClock.bounds`); else NaN.
        contradiction: why this photo may be another one, "" if nothing speaks for that.
        reported_s: when the first report of the photo arrived: it was not exposed later than that; NaN without one.
        counted_s: when the camera's count of its photos was first seen to include it; NaN if it was not.
    """

    level: EvidenceLevel
    received_s: float
    exposed_vehicle_s: float = float("nan")
    image_index: int = -1
    file_url: str = ""
    time_utc_s: float = float("nan")
    latitude_deg: float = float("nan")
    longitude_deg: float = float("nan")
    altitude_m: float = float("nan")
    duplicates: int = 0
    exposed_s: float = float("nan")
    exposed_error_s: float = float("nan")
    opened_s: tuple[float, float] = (float("nan"), float("nan"))
    contradiction: str = ""
    reported_s: float = float("nan")
    counted_s: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecalledPhoto:
    """An earlier photo, reported by the camera on request.

    Attributes:
        evidence: the camera's report.
        exposed_utc_s: time of the exposure on this machine's wall clock; NaN if unknown.
    """

    evidence: CaptureEvidence
    exposed_utc_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RecalledPhotos:
    """The camera's latest photos, reported on request.

    Attributes:
        photos: oldest first.
        image_count: the camera's image count, -1 if unknown.
    """

    photos: tuple[RecalledPhoto, ...] = ()
    image_count: int = -1


class PendingCapture(Protocol):
    """A triggered photo; its evidence arrives while the mission continues."""

    @property
    def commanded_s(self) -> float:
        """When the trigger command was sent; the exposure is not earlier."""
        ...

    @property
    def acknowledged_s(self) -> float:
        """When the acknowledgement arrived; NaN without one, as over a cable."""
        ...

    async def evidence(self, at_least: EvidenceLevel, timeout_s: float) -> CaptureEvidence:
        """Wait for evidence of level `at_least`; after `timeout_s` (from the trigger) return the best so far."""
        ...


class Camera(Protocol):
    """A camera that is triggered by command."""

    async def trigger(self) -> PendingCapture:
        """Take one photo; returns when the command was acknowledged.

        Raises:
            DeviceError: refused (storage full, busy) or not answered.
            LinkError: no link.
        """
        ...

    @property
    def storage_free_images(self) -> float:
        """How many more photos the storage holds; infinity if unknown."""
        ...


class AttitudeFeed(Protocol):
    """The stream of gimbal attitudes, newest kept.

    Reports are ingested by `ingest`, by `newer_than`, and about once a second. The others only read what was ingested.
    """

    def ingest(self) -> None:
        """Take in all reports that have arrived; before reading, where the newest counts."""
        ...

    @property
    def latest(self) -> AttitudeSample | None:
        """The newest sample that was ingested, or None before the first."""
        ...

    def since(self, received_s: float) -> Sequence[AttitudeSample]:
        """All ingested samples that arrived after `received_s`, oldest first; at least the last 60 s are kept."""
        ...

    @property
    def late_s(self) -> float:
        """By how much longer reports are under way than at best so far, by their time stamps; seconds, 0 if unknown."""
        ...

    async def newer_than(self, received_s: float) -> AttitudeSample:
        """The first sample that arrives after `received_s`; has no timeout of its own."""
        ...

    def vehicle_attitude_at(self, sample: AttitudeSample) -> VehicleAttitude | None:
        """The airframe's attitude nearest in time to the sample, None if none is within 0.1 s."""
        ...


@dataclass(frozen=True, slots=True)
class SteadyError:
    """Where a gimbal came to rest beside its commands: errors about its pitch, roll and yaw axis, degrees.

    Attributes:
        mean_deg: mean errors of pitch, roll and yaw.
        hold_deg: the tolerances of pitch, roll and yaw that all its reports at rest are within.
    """

    mean_deg: tuple[float, float, float]
    hold_deg: tuple[float, float, float]


@dataclass(slots=True, kw_only=True)
class GimbalKnowledge:
    """What is known of a gimbal; kept as long as its link, over several missions.

    Attributes:
        manager: MAVLink component of its manager; 0 before it is known.
        device: MAVLink component whose attitude counts; 0 before one was chosen.
        device_id: its gimbal device id (1 to 6: driven by the autopilot itself).
        feedback: the kind of its reports: `earth`, `vehicle`, `body` or `none`; "" before it is known.
        echo: why its reports repeat the command instead of measuring; "" as long as nothing says so.
        steady_error: where it came to rest beside its commands; None: not seen.
        strangers: components that told attitudes and are ignored.
        north_off_deg: the vehicle's heading as the gimbal tells it minus that of the autopilot; NaN: not told.
        north_corrected: whether its reports are corrected by that difference.
    """

    manager: int = 0
    device: int = 0
    device_id: int = 0
    feedback: str = ""
    echo: str = ""
    steady_error: SteadyError | None = None
    strangers: set[int] = field(default_factory=set)
    north_off_deg: float = float("nan")
    north_corrected: bool = False


class Gimbal(Protocol):
    """A gimbal. An accepted command does not mean that the pose was reached: that shows the feed."""

    @property
    def feed(self) -> AttitudeFeed:
        """Its attitude reports."""
        ...

    @property
    def known(self) -> GimbalKnowledge:
        """What is known of it; missions add to it what they observe."""
        ...

    @property
    def limits(self) -> GimbalLimits | None:
        """Angle limits reported by the gimbal manager, None if unknown."""
        ...

    @property
    def in_control(self) -> bool:
        """Whether panoexec has primary control, by the manager's last status."""
        ...

    @property
    def controlled_by(self) -> tuple[int, int] | None:
        """MAVLink system and component in primary control, (0, 0) for none; None if unknown."""
        ...

    async def acquire(self) -> None:
        """Take primary control and return when the manager confirms it.

        Raises:
            DeviceError: refused, or not confirmed in time.
            LinkError: no link.
        """
        ...

    async def point(self, pitch_deg: float, yaw_deg: float | None) -> None:
        """Command an earth-fixed pose (yaw from true north) with roll 0; returns when accepted.

        Without a yaw the camera follows the vehicle's heading.

        Raises:
            DeviceError: refused or not answered.
            LinkError: no link.
        """
        ...

    async def release(self) -> None:
        """Release control; does not raise if the gimbal does not answer, and takes at most 3 s."""
        ...


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """The newest status of the vehicle; NaN or "" for unknown values.

    Attributes:
        connected: whether heartbeats arrive.
        armed: whether the motors are armed.
        in_air: by the landed state.
        mode: flight mode as the adapter names it (MAVSDK's names: HOLD, OFFBOARD = GUIDED, STABILIZED, ...).
        own_mode: what the autopilot's ground stations call it (GUIDED, RTL, Hold).
        heading_deg: true heading [0, 360).
        latitude_deg, longitude_deg, altitude_m, relative_altitude_m: position.
        battery_frac: 0 to 1.
        position_ok: whether the estimator reports a valid global position.
        position_doubts: why the position is not to be trusted now, for the pilot; empty if nothing is reported.
        boot_count: number of reboots detected since the adapter started.
        heartbeats: number of the autopilot's heartbeats since the adapter started; `mode` is that of the last one.
        unhealthy: names of the attitude and height sensors in use that are reported as unhealthy.
    """

    connected: bool = False
    armed: bool = False
    in_air: bool = False
    mode: str = ""
    heading_deg: float = float("nan")
    latitude_deg: float = float("nan")
    longitude_deg: float = float("nan")
    altitude_m: float = float("nan")
    relative_altitude_m: float = float("nan")
    battery_frac: float = float("nan")
    position_ok: bool = False
    position_doubts: tuple[str, ...] = ()
    boot_count: int = 0
    heartbeats: int = 0
    unhealthy: tuple[str, ...] = ()
    own_mode: str = ""

    @property
    def mode_text(self) -> str:
        """The flight mode for people: as the pilot knows it, and as the configuration names it."""
        if not self.own_mode or self.own_mode.upper() == self.mode:
            return self.own_mode or self.mode or "unknown"
        return f"{self.own_mode} ({self.mode})" if self.mode not in {"", "UNKNOWN"} else self.own_mode


class Severity(IntEnum):
    """Severity of a message to the pilot (MAV_SEVERITY)."""

    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class Vehicle(Protocol):
    """The airframe that carries gimbal and camera."""

    @property
    def status(self) -> VehicleStatus:
        """The newest known status."""
        ...

    @property
    def turn_modes(self) -> tuple[str, ...]:
        """Flight modes, as in `status`, in which it executes `turn`; empty if there are none."""
        ...

    async def turn(self, heading_deg: float, rate_deg_s: float) -> None:
        """Turn to a true heading on the spot, the short way, and hold it; returns when the command was accepted.

        In a mode other than `turn_modes` an autopilot may accept the command and do nothing.

        Raises:
            DeviceError: refused or not answered.
            LinkError: no link.
        """
        ...

    async def say(self, text: str, severity: Severity = Severity.NOTICE) -> None:
        """Send text to the ground stations (STATUSTEXT, at most 50 characters per line); never raises."""
        ...
