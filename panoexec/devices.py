"""The seam between a mission and the hardware: what the executor asks of a gimbal, a camera and a vehicle.

Adapters implement these protocols (`panoexec.adapters`); the executor and the tests see nothing else. All times named
`*_s` are seconds of the mission's `Clock.monotonic`, stamped by the adapter when a message arrives, unless they say
`vehicle`: then they are seconds since boot on the sender's clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Protocol, TypeAlias

from panoexec.planning.model import GimbalLimits

Quaternion: TypeAlias = tuple[float, float, float, float]
"""`[w, x, y, z]`, from the body's frame (FRD) to the frame that is named beside it."""


class YawFrame(StrEnum):
    """What a gimbal's attitude is relative to."""

    EARTH = "earth"
    """Camera to world (NED, yaw from true north)."""
    VEHICLE = "vehicle"
    """Yaw from the vehicle's heading, roll and pitch from the horizon (MAVLink's YAW_IN_VEHICLE_FRAME)."""
    BODY = "body"
    """Relative to the vehicle's airframe in all three axes (a servo mount that reports its demanded servo angles)."""


@dataclass(frozen=True, slots=True)
class AttitudeSample:
    """One attitude report of the gimbal, as sent. Numbers may be NaN when the device says so: never within τ.

    Attributes:
        received_s: when it arrived, freed of jitter where the sender stamps its messages: never later than the arrival.
        vehicle_s: when it was measured, the sender's boot time; NaN if not told.
        q_wxyz: camera (FRD) to the frame that `yaw_frame` names.
        yaw_frame: what the attitude is relative to.
        rate_deg_s: magnitude of the angular velocity; NaN if not told.
        failure_flags: the device's own errors (GIMBAL_DEVICE_ERROR_FLAGS), 0 = none.
    """

    received_s: float
    vehicle_s: float
    q_wxyz: Quaternion
    yaw_frame: YawFrame
    rate_deg_s: float
    failure_flags: int = 0


@dataclass(frozen=True, slots=True)
class VehicleAttitude:
    """One attitude report of the airframe (FRD to world), for composing what a gimbal reports relative to it."""

    received_s: float
    vehicle_s: float
    q_wxyz: Quaternion


class EvidenceLevel(IntEnum):
    """How well a photo is proven, weakest first."""

    COMMANDED = 0
    """The trigger was sent."""
    ACKNOWLEDGED = 1
    """The autopilot or the camera accepted it."""
    COUNTED = 2
    """CAMERA_FEEDBACK (180) at the trigger, or CAMERA_CAPTURE_STATUS (262) counted one more."""
    FEEDBACK_PIN = 3
    """CAMERA_FEEDBACK from a wired hot-shoe pin: the shutter did open."""
    CAPTURE_MESSAGE = 4
    """CAMERA_IMAGE_CAPTURED (263) from the camera itself, with success."""
    FILE_SEEN = 5
    """The image file was seen."""


@dataclass(frozen=True, slots=True)
class CaptureEvidence:
    """All that became known of one photo; reports of the same photo are merged.

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
        contradiction: why this photo may be another one, "" if nothing speaks for that.
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
    contradiction: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class RememberedPhoto:
    """A photo that a camera tells of long after it was taken.

    Attributes:
        evidence: what the camera tells of it.
        exposed_utc_s: when it was exposed on this machine's wall clock; NaN if that cannot be told.
    """

    evidence: CaptureEvidence
    exposed_utc_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Recollection:
    """What a camera remembers.

    Attributes:
        photos: its last few, oldest first.
        image_count: how many images it counts, -1 if it does not say.
    """

    photos: tuple[RememberedPhoto, ...] = ()
    image_count: int = -1


class PendingCapture(Protocol):
    """A photo that was asked for; its evidence comes while the mission goes on."""

    @property
    def commanded_s(self) -> float:
        """When the trigger was put on the wire: the exposure is not earlier."""
        ...

    @property
    def acknowledged_s(self) -> float:
        """When the acknowledgement arrived; NaN where nobody acknowledges, as over a cable."""
        ...

    async def evidence(self, at_least: EvidenceLevel, timeout_s: float) -> CaptureEvidence:
        """Wait for proof of level `at_least`; after `timeout_s` (since the trigger) return the best there is."""
        ...


class Camera(Protocol):
    """Fires, and says what is known of the photo."""

    async def trigger(self) -> PendingCapture:
        """Take one photo; returns when the command was acknowledged.

        Raises:
            DeviceError: refused (storage full, busy) or not answered.
            LinkError: no link.
        """
        ...

    @property
    def storage_free_images(self) -> float:
        """How many more photos fit, as far as is known; infinity if the camera does not say."""
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

    async def newer_than(self, received_s: float) -> AttitudeSample:
        """The first sample to arrive after `received_s`; waits for ever, callers bound it."""
        ...

    def vehicle_attitude_at(self, sample: AttitudeSample) -> VehicleAttitude | None:
        """The airframe's attitude nearest in time to the sample, None if none is within 0.1 s."""
        ...


class Gimbal(Protocol):
    """Points a camera. Accepted is not arrived: judge by the feed."""

    @property
    def feed(self) -> AttitudeFeed:
        """Its attitude reports."""
        ...

    @property
    def limits(self) -> GimbalLimits | None:
        """Angle limits as the gimbal manager states them, None if it does not."""
        ...

    @property
    def in_control(self) -> bool:
        """Whether the manager names us as the one in primary control, as of its last status."""
        ...

    @property
    def controlled_by(self) -> tuple[int, int] | None:
        """MAVLink system and component in primary control, (0, 0) for nobody; None if that is not known."""
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

        Without a yaw the camera looks along the vehicle's nose and follows it.

        Raises:
            DeviceError: refused or not answered.
            LinkError: no link.
        """
        ...

    async def release(self) -> None:
        """Give control back; never raises for a gimbal that is gone, and takes 3 s at most."""
        ...


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """The newest of what the vehicle says of itself; NaN or "" where it has not said.

    Attributes:
        connected: whether heartbeats arrive.
        armed: motors may turn.
        in_air: the landed state says so.
        mode: flight mode as the adapter names it (MAVSDK's names: HOLD, OFFBOARD = GUIDED, STABILIZED, ...).
        heading_deg: true heading [0, 360).
        latitude_deg, longitude_deg, altitude_m, relative_altitude_m: position.
        battery_frac: 0 to 1.
        position_ok: the estimator says that the global position is good.
        boot_count: how many reboots were noticed since the adapter started.
        unhealthy: sensors of its attitude and height that it uses and calls unhealthy, in words.
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
    boot_count: int = 0
    unhealthy: tuple[str, ...] = ()


class Severity(IntEnum):
    """How urgent a word to the pilot is (MAV_SEVERITY)."""

    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class Vehicle(Protocol):
    """The airframe that carries gimbal and camera."""

    @property
    def status(self) -> VehicleStatus:
        """The newest known status; costs nothing to read."""
        ...

    @property
    def turn_modes(self) -> tuple[str, ...]:
        """Flight modes, as `status` names them, in which it obeys `turn`; empty if there are none."""
        ...

    async def turn(self, heading_deg: float, rate_deg_s: float) -> None:
        """Turn the nose on the spot to a true heading, the short way, and keep it there; returns when accepted.

        Accepted is not arrived, and in a mode that is none of `turn_modes` an autopilot may accept it and do nothing.

        Raises:
            DeviceError: refused or not answered.
            LinkError: no link.
        """
        ...

    async def say(self, text: str, severity: Severity = Severity.NOTICE) -> None:
        """Tell the pilot's ground station (STATUSTEXT, at most 50 characters a line); never raises."""
        ...
