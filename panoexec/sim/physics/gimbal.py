"""The gimbal's mechanics: three axes with limits, a control loop that overshoots and settles, noise, drift, gusts.

Pure: no I/O, no clock; `step` advances it. Angles are the 3-1-2 axes of `panoexec.angles` in the world frame (a gimbal
with an inertial sensor controls those, independent of the vehicle's attitude).

Estimate and truth:

* `estimate` is the attitude that the gimbal's controller works with. Overshoot, gusts, slips and wrong commands move
  it, and it is reported (plus white encoder noise).
* the *true* attitude is the estimate minus the heading error: the compass heading that the yaw estimate is based on has
  an error of up to `heading_error_deg`, drifting slowly. No report shows it; the images do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from panoexec.sim.config import AxisConfig, GimbalConfig
from panoexec.sim.physics.world import BoundedDrift, ColouredNoise, seeded

_GUST_REFERENCE_M_S = 10.0


class Angles(NamedTuple):
    """Yaw, roll, pitch of the gimbal's axes, degrees, 3-1-2 order."""

    yaw_deg: float
    roll_deg: float
    pitch_deg: float


class Rates(NamedTuple):
    """Rates of the three axes, degrees per second."""

    yaw_deg_s: float
    roll_deg_s: float
    pitch_deg_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """The gimbal's setpoint.

    Attributes:
        pitch_deg, roll_deg: relative to the horizon.
        yaw_deg: from true north with `yaw_lock`, else from the vehicle's nose.
        yaw_lock: hold the yaw in the earth frame, independent of the vehicle's heading.
        rates: if given, rotate at these rates instead; the angles are ignored.
    """

    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    yaw_deg: float = 0.0
    yaw_lock: bool = False
    rates: Rates | None = None


class Axis:
    """One axis: a time-optimal reference within rate and acceleration, tracked by a second-order loop."""

    def __init__(self, config: AxisConfig, *, loop_hz: float, damping: float, feedforward_frac: float) -> None:
        self.config = config
        omega = 2 * math.pi * loop_hz
        self._stiffness = omega * omega
        self._viscosity = 2 * damping * omega
        self._feedforward = feedforward_frac
        self.reference_deg = 0.0
        self._reference_deg_s = 0.0
        self.angle_deg = 0.0
        self.rate_deg_s = 0.0

    def place(self, angle_deg: float) -> None:
        """Set the angle, at rest."""
        self.reference_deg = self.angle_deg = angle_deg
        self._reference_deg_s = self.rate_deg_s = 0.0

    def step(
        self, target_deg: float, disturbance_deg_s2: float, dt: float, slowness: float, speed_deg_s: float = math.inf
    ) -> None:
        """Advance by `dt` towards the target, which may be infinite, at most at `speed_deg_s`.

        `slowness` scales the axis's rate and acceleration.
        """
        top = min(self.config.rate_deg_s * slowness, speed_deg_s)
        acceleration = self.config.acceleration_deg_s2 * slowness
        error = target_deg - self.reference_deg
        quantum = acceleration * dt
        if abs(error) <= quantum * dt and abs(self._reference_deg_s) <= quantum:
            wanted = error / dt
        else:
            # the speed from which the axis can still stop at the target in whole steps
            stoppable = quantum * (math.sqrt(1 + 8 * abs(error) / (quantum * dt)) - 1) / 2
            wanted = math.copysign(min(top, stoppable), error)
        change = min(max(wanted - self._reference_deg_s, -quantum), quantum)
        self._reference_deg_s += change
        self.reference_deg += self._reference_deg_s * dt
        # semi-implicit Euler: stable for dt well below 2 / (viscosity + omega), 40 ms with the default loop
        torque = (
            self._stiffness * (self.reference_deg - self.angle_deg)
            + self._viscosity * (self._reference_deg_s - self.rate_deg_s)
            + self._feedforward * change / dt
            + disturbance_deg_s2
        )
        self.rate_deg_s += torque * dt
        self.angle_deg += self.rate_deg_s * dt

    def stop_at(self, low_deg: float, high_deg: float) -> None:
        """Stop at a mechanical end stop."""
        if not low_deg <= self.angle_deg <= high_deg:
            self.angle_deg = min(max(self.angle_deg, low_deg), high_deg)
            self.rate_deg_s = 0.0

    def freeze(self) -> None:
        """Stop at the current angle."""
        self.place(self.angle_deg)


class GimbalPhysics:
    """Three axes on a vehicle that rotates under them.

    Attributes:
        stuck: the motors do not move (fault).
        slowness: factor on rates and accelerations, 1 = healthy (fault).
        wind_m_s: current wind speed.
    """

    def __init__(self, config: GimbalConfig, *, seed: int, step_s: float) -> None:
        self.config = config
        self._step_s = step_s
        self._yaw, self._roll, self._pitch = (
            Axis(axis, loop_hz=config.loop_hz, damping=config.damping, feedforward_frac=config.feedforward_frac)
            for axis in (config.yaw, config.roll, config.pitch)
        )
        self._heading_error = BoundedDrift(
            config.heading_error_deg, config.heading_period_s, seeded(seed, "gimbal/heading")
        )
        gust = seeded(seed, "gimbal/gust")
        self._gusts = [ColouredNoise(config.gust_corner_hz, step_s, gust) for _ in range(3)]
        self._encoder = seeded(seed, "gimbal/encoder")
        self._gyroscopes = seeded(seed, "gimbal/gyroscopes")
        self._target = Target()
        self._nose_deg = 0.0  # the vehicle's heading, unwrapped
        self._slip = _Slip()
        self.time_s = 0.0
        self.stuck = False
        self.slowness = 1.0
        self.wind_m_s = 0.0

    @property
    def target(self) -> Target:
        """The last setpoint, clipped to the limits."""
        return self._target

    @property
    def heading_error_deg(self) -> float:
        """Estimated minus true yaw; the vehicle's own heading has the same error."""
        return self._heading_error.at(self.time_s)

    def start_at(self, vehicle_yaw_deg: float) -> None:
        """Set a level attitude along the vehicle's nose (its estimated heading)."""
        self._nose_deg = vehicle_yaw_deg
        self._yaw.place(vehicle_yaw_deg)

    def command(self, target: Target) -> None:
        """Set a new target; angles beyond the limits are clipped without notice, as in real gimbals."""
        c = self.config
        yaw = target.yaw_deg
        if not target.yaw_lock and not c.yaw_endless:
            yaw = _clip(_wrap(yaw) if abs(yaw) > 360 else yaw, c.yaw)
        self._target = Target(
            pitch_deg=_clip(target.pitch_deg, c.pitch),
            roll_deg=_clip(target.roll_deg, c.roll),
            yaw_deg=yaw,
            yaw_lock=target.yaw_lock,
            rates=target.rates,
        )

    def slip(self, yaw_deg: float, pitch_deg: float, hold_s: float) -> None:
        """Ramp the pointing off by these angles within 0.04 s, hold for `hold_s`, and return (fault `drift`)."""
        self._slip = _Slip(yaw_deg=yaw_deg, pitch_deg=pitch_deg, start_s=self.time_s, hold_s=hold_s)

    def step(self, vehicle_yaw_deg: float) -> None:
        """Advance by one step of physics on a vehicle with the given *estimated* heading."""
        dt = self._step_s
        self.time_s += dt
        turn = _wrap(vehicle_yaw_deg - self._nose_deg)
        self._nose_deg += turn
        vehicle_rate = turn / dt
        strength = self.config.gust_deg_s2 * (self.wind_m_s / _GUST_REFERENCE_M_S) ** 2
        gusts = [strength * gust.step() for gust in self._gusts]
        if self.stuck:
            # seized bearings: roll and pitch stay, yaw turns with the vehicle
            for axis in (self._yaw, self._roll, self._pitch):
                axis.freeze()
            self._yaw.place(self._yaw.angle_deg + vehicle_rate * dt)
            return
        target = self._target
        rates = target.rates
        if not self.config.pans:
            # levelled about the airframe's axes, the camera points along the nose, whatever the vehicle's tilt
            self._yaw.place(self._nose_deg)
            self._yaw.rate_deg_s = vehicle_rate
        elif rates is None:
            self._yaw.step(self._yaw_goal() + self.config.steady_error_deg, gusts[0], dt, self.slowness)
        else:
            yaw_rate = rates.yaw_deg_s + (0.0 if target.yaw_lock else vehicle_rate)
            self._yaw.step(self._yaw_end(yaw_rate), gusts[0], dt, self.slowness, abs(yaw_rate))
        if rates is None:
            self._roll.step(target.roll_deg, gusts[1], dt, self.slowness)
            self._pitch.step(target.pitch_deg + self.config.steady_error_deg, gusts[2], dt, self.slowness)
        else:
            far = _end(rates.roll_deg_s, self.config.roll)
            self._roll.step(far, gusts[1], dt, self.slowness, abs(rates.roll_deg_s))
            far = _end(rates.pitch_deg_s, self.config.pitch)
            self._pitch.step(far, gusts[2], dt, self.slowness, abs(rates.pitch_deg_s))
        margin = self.config.stop_margin_deg
        self._roll.stop_at(self.config.roll.min_deg - margin, self.config.roll.max_deg + margin)
        self._pitch.stop_at(self.config.pitch.min_deg - margin, self.config.pitch.max_deg + margin)

    def _yaw_end(self, rate_deg_s: float) -> float:
        """The angle at which a rotation at this rate must end."""
        if self.config.yaw_endless:
            return math.copysign(math.inf, rate_deg_s)
        return self._nose_deg + _end(rate_deg_s, self.config.yaw)

    def _yaw_goal(self) -> float:
        """The target's yaw, unwrapped like the axis: the shorter way, or the way that the stops allow."""
        nose, here = self._nose_deg, self._yaw.reference_deg
        goal = self._target.yaw_deg if self._target.yaw_lock else self._target.yaw_deg + nose
        goal = here + _wrap(goal - here)
        if self.config.yaw_endless:
            return goal
        axis = self.config.yaw
        joint = goal - nose
        if joint > axis.max_deg:
            joint = joint - 360 if joint - 360 >= axis.min_deg else axis.max_deg
        elif joint < axis.min_deg:
            joint = joint + 360 if joint + 360 <= axis.max_deg else axis.min_deg
        return nose + joint

    @property
    def estimate(self) -> Angles:
        """The attitude estimate of the gimbal's controller, without noise; yaw from north as estimated."""
        yaw_slip, pitch_slip = self._slip.at(self.time_s)
        return Angles(self._yaw.angle_deg + yaw_slip, self._roll.angle_deg, self._pitch.angle_deg + pitch_slip)

    @property
    def truth(self) -> Angles:
        """The true attitude of the camera; yaw from true north."""
        return self.truth_at(self.time_s)

    def truth_at(self, t_s: float) -> Angles:
        """`truth` at a time at most one step from the last one."""
        angles, rates, ahead, c = self.estimate, self.rates, t_s - self.time_s, self.config
        return Angles(
            angles.yaw_deg - self._heading_error.at(t_s) + rates.yaw_deg_s * ahead,
            angles.roll_deg - c.roll_bias_deg + rates.roll_deg_s * ahead,
            angles.pitch_deg - c.pitch_bias_deg + rates.pitch_deg_s * ahead,
        )

    @property
    def nose_deg(self) -> float:
        """The vehicle's estimated heading, unwrapped."""
        return self._nose_deg

    @property
    def rates(self) -> Rates:
        """Rates of the axes in the earth frame."""
        now, before = self._slip.at(self.time_s), self._slip.at(self.time_s - self._step_s)
        yaw_slip, pitch_slip = ((a - b) / self._step_s for a, b in zip(now, before, strict=True))
        return Rates(self._yaw.rate_deg_s + yaw_slip, self._roll.rate_deg_s, self._pitch.rate_deg_s + pitch_slip)

    def measure_rates(self) -> Rates:
        """Rates for one report, with new noise of the gyroscopes."""
        noise, gauss = self.config.rate_noise_deg_s, self._gyroscopes.gauss
        yaw_s, roll_s, pitch_s = self.rates
        return Rates(yaw_s + gauss(0.0, noise), roll_s + gauss(0.0, noise), pitch_s + gauss(0.0, noise))

    def measure(self) -> Angles:
        """One report: the estimate with new encoder noise."""
        yaw, roll, pitch = self.estimate
        gauss, c = self._encoder.gauss, self.config
        yaw += gauss(0.0, c.yaw.noise_deg)
        roll += gauss(0.0, c.roll.noise_deg)
        pitch += gauss(0.0, c.pitch.noise_deg)
        return Angles(yaw, roll, pitch)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Slip:
    """A pointing error that ramps up, holds and decays."""

    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    start_s: float = -math.inf
    hold_s: float = 0.0
    ramp_s: float = 0.04
    back_s: float = 0.4

    def at(self, t_s: float) -> tuple[float, float]:
        age = t_s - self.start_s
        if age < self.ramp_s:
            share = age / self.ramp_s
        elif age < self.ramp_s + self.hold_s:
            share = 1.0
        else:
            share = max(0.0, 1 - (age - self.ramp_s - self.hold_s) / self.back_s)
        return self.yaw_deg * share, self.pitch_deg * share


def _wrap(angle_deg: float) -> float:
    return (angle_deg + 180.0) % 360.0 - 180.0


def _end(rate_deg_s: float, axis: AxisConfig) -> float:
    return axis.max_deg if rate_deg_s > 0 else axis.min_deg


def _clip(angle_deg: float, axis: AxisConfig) -> float:
    return min(max(angle_deg, axis.min_deg), axis.max_deg)


def quaternion(angles: Angles) -> tuple[float, float, float, float]:
    """`[w, x, y, z]` of Rz(yaw) · Rx(roll) · Ry(pitch), like `panoexec.angles.rotation` without arrays."""
    half = math.pi / 360
    cy, sy = math.cos(angles.yaw_deg * half), math.sin(angles.yaw_deg * half)
    cr, sr = math.cos(angles.roll_deg * half), math.sin(angles.roll_deg * half)
    cp, sp = math.cos(angles.pitch_deg * half), math.sin(angles.pitch_deg * half)
    return (
        cy * cr * cp - sy * sr * sp,
        cy * sr * cp - sy * cr * sp,
        cy * cr * sp + sy * sr * cp,
        cy * sr * sp + sy * cr * cp,
    )


def angles_of(q: tuple[float, float, float, float]) -> Angles:
    """The 3-1-2 angles of a quaternion `[w, x, y, z]`; the inverse of `quaternion`."""
    w, x, y, z = q
    m21 = 2 * (y * z + w * x)
    m01, m11 = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z)
    m20, m22 = 2 * (x * z - w * y), 1 - 2 * (x * x + y * y)
    return Angles(
        math.degrees(math.atan2(-m01, m11)),
        math.degrees(math.atan2(m21, math.hypot(m01, m11))),
        math.degrees(math.atan2(-m20, m22)),
    )


def body_rates(angles: Angles, rates: Rates) -> tuple[float, float, float]:
    """Angular velocity about the camera's own x, y, z, rad/s, of axis rates at these axis angles.

    ω = Ry(pitch)ᵀ · (Rx(roll)ᵀ · ẑ · ẏaw + x̂ · ṙoll) + ŷ · ṗitch.
    """
    roll, pitch = math.radians(angles.roll_deg), math.radians(angles.pitch_deg)
    yaw_s, roll_s, pitch_s = (math.radians(rate) for rate in rates)
    x, y, z = roll_s, yaw_s * math.sin(roll), yaw_s * math.cos(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    return cp * x - sp * z, y + pitch_s, sp * x + cp * z
