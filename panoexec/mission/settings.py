"""How a mission is flown: every number that the executor decides by, with its unit and its default."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated, Literal, TypeAlias

from panoexec.codec import ByName, Flag, Number, Whole
from panoexec.devices import EvidenceLevel
from panoexec.errors import UsageError
from panoexec.planning.model import GimbalLimits, Tolerance

AcceptBy: TypeAlias = Literal["tolerance", "overlap"]
Feedback: TypeAlias = Literal["auto", "none"]
Reclaim: TypeAlias = Literal["ask", "never"]


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardSettings:
    """When a flight holds or ends by itself.

    Attributes:
        battery_floor_frac: no shot below this charge, 0 to 1; 0 switches the guard off.
        hover_s: how long a full battery keeps the vehicle in the air, for the check against the estimate; 0: unknown.
        position_drift_m: how far from where the mission began (parallax), metres; twice that in height, which
            satellites tell worse; infinity switches it off.
        position_back_frac: it goes on when back within this fraction of that distance.
        allowed_modes: flight modes (as the adapter names them) in which the mission may use the gimbal; empty = all.
        attitude_silence_s: how long the gimbal may be silent.
        clear_s: how long a cause must be gone before the mission goes on by itself.
        position_hold: whether preflight asks for a good position and a vehicle in the air.
        reclaim: what to do when another component takes the gimbal: ask for it back, or wait for the pilot.
        reclaim_after_s: how long to leave it to the other one before asking.
    """

    battery_floor_frac: Number = 0.25
    hover_s: Number = 1200.0
    position_drift_m: Number = 3.0
    position_back_frac: Number = 0.7
    allowed_modes: tuple[str, ...] = ()
    attitude_silence_s: Number = 1.0
    clear_s: Number = 1.0
    position_hold: Flag = True
    reclaim: Reclaim = "ask"
    reclaim_after_s: Number = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionSettings:
    """Everything that a mission decides by.

    Attributes:
        tolerance: largest accepted pointing error of each gimbal axis.
        settle_s: how long it must have been inside tolerance before the photo.
        max_rate_deg_s: largest angular speed that counts as settled.
        max_gap_s: longest silence of the attitude stream that still proves a pose.
        patience_s: how long settling may take beyond the expected slew; doubles with each round.
        attempts: photos or settle time-outs of a shot, one after the other, before it is put off.
        rounds: passes over the shots, the first included.
        exposure_s: the longest exposure.
        latency_s: bound on the time from the trigger command to the opening of the shutter.
        interval_s: least time between two triggers.
        brackets: photos of each pose.
        min_evidence: what a photo must be proven by.
        evidence_s: how long to wait for that proof, from the trigger.
        pending: photos whose evidence may be outstanding when the next trigger goes out.
        accept: `tolerance`: every sample inside tolerance; `overlap`: or the certificate holds as measured.
        patches: rounds of patch shots for real holes at the end; 0 = none.
        feedback: `auto`: judge by the attitude stream; `none`: there is none, poses are believed after the slew time.
        gimbal: limits, rates and accelerations; limits that the gimbal states itself come first.
        guards: see `GuardSettings`.
        max_pause_s: a pause longer than this ends the mission (as failed: it can be resumed).
        device_tries: how often a refused pointing command is repeated at once.
        release_s: how long giving the gimbal back may take at the end.
    """

    tolerance: Tolerance
    settle_s: Number = 0.3
    max_rate_deg_s: Number = 2.0
    max_gap_s: Number = 0.1
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

    def __post_init__(self) -> None:
        """Refuse what no mission could be flown with.

        Raises:
            UsageError: naming the setting, the value and what would be accepted.
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
                raise UsageError(f"tolerance {axis.name} = {value!r}: must be more than 0, no gimbal is perfect")

    @property
    def exposure_bound_s(self) -> float:
        """From the trigger command on the wire to the latest end of the exposure."""
        return self.latency_s + self.exposure_s
