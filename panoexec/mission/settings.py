"""Mission settings: every parameter of the executor with its unit and default."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated, Literal, TypeAlias

from panoexec.codec import ByName, Flag, Number, Whole
from panoexec.devices import EvidenceLevel
from panoexec.errors import UsageError
from panoexec.planning.model import GimbalLimits, Tolerance

AcceptBy: TypeAlias = Literal["tolerance", "overlap"]
Feedback: TypeAlias = Literal["auto", "none"]
PictureCheck: TypeAlias = Literal["off", "warn", "retake"]
Reclaim: TypeAlias = Literal["ask", "never"]


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardSettings:
    """When a mission pauses or ends by itself.

    Attributes:
        battery_floor_frac: no shot below this charge, 0 to 1; 0 disables the guard.
        hover_s: hover time with a full battery, compared with the estimated duration; 0: unknown.
        position_drift_m: largest horizontal distance from the mission's origin (parallax), metres; twice that
            vertically, where GNSS is less accurate; infinity disables the guard.
        parallax_px: largest seam error between two photos that the drift may cause, pixels of the photo
            (`panoexec.mission.parallax`); 0: it is told, nothing follows.
        position_back_frac: a position hold ends within this fraction of that distance.
        allowed_modes: flight modes (as the adapter names them) in which the mission may use the gimbal; empty = all.
        attitude_silence_s: longest time without an attitude sample.
        clear_s: how long the cause of a hold must be absent before the mission continues by itself.
        position_hold: whether preflight requires a valid position and a vehicle in the air.
        reclaim: what to do when another component takes the gimbal: request it back (`ask`), or wait for the pilot.
        reclaim_after_s: delay before the request.
    """

    battery_floor_frac: Number = 0.25
    hover_s: Number = 1200.0
    position_drift_m: Number = 3.0
    parallax_px: Number = 0.0
    position_back_frac: Number = 0.7
    allowed_modes: tuple[str, ...] = ()
    attitude_silence_s: Number = 1.0
    clear_s: Number = 1.0
    position_hold: Flag = True
    reclaim: Reclaim = "ask"
    reclaim_after_s: Number = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionSettings:
    """All parameters of the executor.

    Attributes:
        tolerance: largest accepted pointing error of each gimbal axis.
        settle_s: how long the pose must have been inside tolerance before the photo.
        max_rate_deg_s: largest angular speed that counts as settled.
        max_gap_s: longest gap between attitude samples; above 0.1 s only as far as the rate of the stream asks for it.
        patience_s: settle timeout beyond the expected slew; doubles with each round.
        attempts: consecutive failed attempts (photos or settle timeouts) before a shot is deferred.
        rounds: passes over the shots, the first included.
        exposure_s: the longest exposure.
        latency_s: upper bound of the shutter lag: from the trigger command to the opening of the shutter.
        interval_s: least time between two triggers.
        brackets: photos per pose.
        min_evidence: least evidence that an accepted photo needs.
        evidence_s: timeout for that evidence, from the trigger.
        pending: photos whose evidence may be outstanding at the next trigger.
        accept: `tolerance`: every sample must be inside tolerance; `overlap`: or the certificate holds with the
            measured pose.
        patches: rounds of patch shots for holes of the measured attitudes; 0 = none.
        feedback: `auto`: judge by the attitude stream; `none`: there is no stream, poses are assumed after the slew.
        gimbal: limits, rates and accelerations; limits that the gimbal reports take precedence.
        guards: see `GuardSettings`.
        max_pause_s: a longer pause ends the mission (as failed; it can be resumed).
        device_tries: how often a refused pointing command is sent.
        release_s: timeout for releasing the gimbal at the end.
        pictures: what follows from the content of photos whose files arrive: nothing (they are not examined), a
            warning, or a retake.
    """

    tolerance: Tolerance
    settle_s: Number = 0.3
    max_rate_deg_s: Number = 2.0
    max_gap_s: Number = 0.25
    patience_s: Number = 4.0
    attempts: Whole = 3
    rounds: Whole = 3
    exposure_s: Number = 0.02
    latency_s: Number = 0.15
    interval_s: Number = 1.0
    brackets: Whole = 1
    min_evidence: Annotated[EvidenceLevel, ByName()] = EvidenceLevel.COUNTED
    evidence_s: Number = 3.0
    pending: Whole = 1
    accept: AcceptBy = "tolerance"
    patches: Whole = 1
    feedback: Feedback = "auto"
    gimbal: GimbalLimits = field(default_factory=GimbalLimits)
    guards: GuardSettings = field(default_factory=GuardSettings)
    max_pause_s: Number = 600.0
    device_tries: Whole = 3
    release_s: Number = 4.0
    pictures: PictureCheck = "off"

    def __post_init__(self) -> None:
        """Validate the values.

        Raises:
            UsageError: a value is out of range; the message names the setting, the value and the valid range.
        """
        positive = ("max_rate_deg_s", "max_gap_s", "patience_s", "evidence_s", "max_pause_s", "release_s")
        not_negative = ("settle_s", "exposure_s", "latency_s", "interval_s", "patches")
        at_least_one = ("attempts", "rounds", "brackets", "pending", "device_tries")
        for bound, text, names in (
            (1e-9, "more than 0", positive),
            (0, "0 or more", not_negative),
            (1, "1 or more", at_least_one),
        ):
            for name in names:
                if not getattr(self, name) >= bound:
                    raise UsageError(f"{name} = {getattr(self, name)!r}: must be {text}")
        for axis in fields(Tolerance):
            value = getattr(self.tolerance, axis.name)
            if not value > 0:
                raise UsageError(f"tolerance {axis.name} = {value!r}: must be more than 0")

    @property
    def exposure_bound_s(self) -> float:
        """Seconds from the trigger command on the wire to the latest end of the exposure."""
        return self.latency_s + self.exposure_s
