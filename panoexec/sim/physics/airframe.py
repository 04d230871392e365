"""The vehicle under the gimbal: hover in wind, GPS drift, battery, arming, take-off and landing. Pure, stepped."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from panoexec.sim.config import AirframeConfig, AxisConfig
from panoexec.sim.physics.gimbal import Axis
from panoexec.sim.physics.world import BoundedDrift, seeded

METRES_PER_DEG = 111_320.0
_LEAN_REFERENCE_M_S = 8.0
_LEAN_MAX_DEG = 35.0
_LEAN_LAG_S = 0.6
_CLIMB_M_S = 2.5
_DESCENT_M_S = 1.0
_FALL_M_S = 12.0
_CRUISE_M_S = 5.0
_BRAKE_M_S2 = 1.0
_IDLE_DRAIN = 0.05
_TURN_DAMPING = 0.9
_TURN_FEEDFORWARD = 0.5
_AT_REST_DEG = 1e-3
_CELLS = 4
_CELL_EMPTY_V, _CELL_FULL_V = 3.3, 4.2


class LandedState(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class AirframeState:
    """True position and attitude of the vehicle.

    Attributes:
        roll_deg, pitch_deg, yaw_deg: attitude (3-2-1, yaw from true north, unwrapped).
        roll_rate_deg_s, pitch_rate_deg_s, yaw_rate_deg_s: their rates.
        north_m, east_m, up_m: true position relative to home: the autopilot holds the GPS position, so the true one
            drifts with the GPS error, which no report shows.
    """

    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    roll_rate_deg_s: float
    pitch_rate_deg_s: float
    yaw_rate_deg_s: float
    north_m: float
    east_m: float
    up_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """GPS position: degrees, metres above mean sea level and above home, velocity north, east, down in m/s."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    relative_altitude_m: float
    velocity_m_s: tuple[float, float, float]


class Airframe:
    """A multirotor that holds its position, with the errors that wind and GPS cause.

    Attributes:
        armed: motors turn.
        wind_m_s: current wind speed.
        battery_frac: state of charge, 0 to 1.
    """

    def __init__(self, config: AirframeConfig, *, seed: int) -> None:
        self.config = config
        self.armed = config.in_air
        self.wind_m_s = config.wind_m_s
        self.battery_frac = config.battery_frac
        self._time_s = 0.0
        self._state: AirframeState | None = None
        self._height_m = config.height_m if config.in_air else 0.0
        self._height_goal_m = self._height_m
        self._lean_deg = self._steady_lean()
        self._climb_m_s = 0.0
        self._away_m = self._goal_m = (0.0, 0.0)
        self._speed_m_s = 0.0
        self._heading_goal_deg = config.heading_deg
        self._heading = self._heading_axis()
        self._turn_deg_s = math.inf

        def wander(name: str, period_s: float) -> BoundedDrift:
            # a bound of 1/0.35 gives a standard deviation of 1
            return BoundedDrift(1 / 0.3536, period_s, seeded(seed, f"airframe/{name}"))

        self._sway_roll, self._sway_pitch = wander("roll", 1.3), wander("pitch", 1.1)
        self._sway_yaw = wander("yaw", 4.0)
        self._hold = [wander(f"hold/{axis}", 6.0) for axis in "neu"]
        self._gps = [wander(f"gps/{axis}", 80.0) for axis in "neu"]

    def _heading_axis(self) -> Axis:
        c = self.config
        limits = AxisConfig(
            rate_deg_s=c.turn_rate_deg_s,
            acceleration_deg_s2=c.turn_acceleration_deg_s2,
            min_deg=-math.inf,
            max_deg=math.inf,
        )
        axis = Axis(limits, loop_hz=c.turn_loop_hz, damping=_TURN_DAMPING, feedforward_frac=_TURN_FEEDFORWARD)
        axis.place(c.heading_deg)
        return axis

    def _steady_lean(self) -> float:
        lean = self.config.lean_deg * (self.wind_m_s / _LEAN_REFERENCE_M_S) ** 2
        return min(lean, _LEAN_MAX_DEG) if self.is_flying else 0.0

    @property
    def is_flying(self) -> bool:
        """Whether it is in the air."""
        return self._height_m > 0.1

    @property
    def landed_state(self) -> LandedState:
        """Value of EXTENDED_SYS_STATE.landed_state."""
        if not self.is_flying or not self.armed:  # an autopilot that is disarmed takes itself for landed
            return LandedState.ON_GROUND
        if self._climb_m_s > 0.5 and self._height_goal_m - self._height_m > 0.5:
            return LandedState.TAKEOFF
        return LandedState.LANDING if self._height_goal_m <= 0 else LandedState.IN_AIR

    @property
    def voltage_v(self) -> float:
        """Battery voltage under load."""
        return _CELLS * (_CELL_EMPTY_V + (_CELL_FULL_V - _CELL_EMPTY_V) * self.battery_frac)

    def arm(self, armed: bool) -> bool:
        """Arm or disarm; returns False (denied) for disarming in the air."""
        if not armed and self.is_flying:
            return False
        self.armed = armed
        return True

    def take_off(self, height_m: float) -> bool:
        """Climb to a height above home; returns False (denied) unless armed."""
        if not self.armed:
            return False
        self._height_goal_m = height_m
        return True

    def land(self) -> None:
        """Land at the current position; disarms on the ground."""
        self._height_goal_m = 0.0

    @property
    def away_m(self) -> tuple[float, float]:
        """North and east of home that it is flown to, metres, without the errors that wind and GPS cause."""
        return self._away_m

    @property
    def height_m(self) -> float:
        """Height above home that it is flown at, metres."""
        return self._height_m

    @property
    def to_go_m(self) -> float:
        """Distance to where it flies, metres."""
        north, east = (goal - now for goal, now in zip(self._goal_m, self._away_m, strict=True))
        return math.hypot(north, east, self._height_goal_m - self._height_m)

    def fly_to(self, north_m: float, east_m: float, height_m: float | None = None) -> None:
        """Fly to a point relative to home, and hover there; the height stays as it is if none is given."""
        if self.is_flying:
            self._goal_m = (north_m, east_m)
            if height_m is not None:
                self._height_goal_m = height_m

    def brake(self) -> None:
        """Stop where it can, as fast as it brakes."""
        north, east = self._direction()
        way = self._speed_m_s**2 / (2 * _BRAKE_M_S2)
        self._goal_m = (self._away_m[0] + way * north, self._away_m[1] + way * east)
        self._height_goal_m = self._height_m

    def _direction(self) -> tuple[float, float]:
        north, east = (goal - now for goal, now in zip(self._goal_m, self._away_m, strict=True))
        way = math.hypot(north, east)
        return (north / way, east / way) if way > 0 else (0.0, 0.0)

    def _fly(self, dt: float) -> None:
        """Towards the goal, with limited speed and acceleration."""
        north, east = self._direction()
        way = math.hypot(*(goal - now for goal, now in zip(self._goal_m, self._away_m, strict=True)))
        self._speed_m_s = min(self._speed_m_s + _BRAKE_M_S2 * dt, _CRUISE_M_S, math.sqrt(2 * _BRAKE_M_S2 * way))
        step = self._speed_m_s * dt
        if step >= way or way < 1e-3:
            self._away_m, self._speed_m_s = self._goal_m, 0.0
        else:
            self._away_m = (self._away_m[0] + step * north, self._away_m[1] + step * east)

    def stop_motors(self) -> None:
        """Disarm wherever it is; in the air it falls."""
        self.armed = False
        self._height_goal_m = 0.0

    def turn_to(self, heading_deg: float, *, rate_deg_s: float = 0.0, direction: int = 0) -> None:
        """Yaw on the spot to a heading and hold it.

        Args:
            heading_deg: clockwise from north as estimated by the autopilot, any number of turns.
            rate_deg_s: maximum rate; 0 or less selects the autopilot's.
            direction: 1 clockwise, -1 counter-clockwise, 0 the shorter way.
        """
        if not self.is_flying:
            return
        way = (heading_deg - self._heading_goal_deg + 180.0) % 360.0 - 180.0
        if direction * way < 0:
            way += math.copysign(360.0, direction)
        self._heading_goal_deg += way
        self._turn_deg_s = rate_deg_s if rate_deg_s > 0 else math.inf

    def step(self, dt: float) -> None:
        """Advance by `dt` seconds."""
        self._time_s += dt
        self._state = None
        if self._heading.angle_deg != self._heading_goal_deg or self._heading.rate_deg_s != 0.0:
            self._turn(dt)
        if self._away_m != self._goal_m:
            self._fly(dt)
        drain = 1.0 if self.is_flying else _IDLE_DRAIN if self.armed else 0.0
        self.battery_frac = max(0.0, self.battery_frac - drain * dt / (60 * self.config.battery_minutes))
        self._lean_deg += (self._steady_lean() - self._lean_deg) * min(1.0, dt / _LEAN_LAG_S)
        way = self._height_goal_m - self._height_m
        self._climb_m_s = min(max(way / max(dt, 1e-9), -(_DESCENT_M_S if self.armed else _FALL_M_S)), _CLIMB_M_S)
        was_flying = self.is_flying
        self._height_m += self._climb_m_s * dt
        if was_flying and not self.is_flying and self._height_goal_m <= 0:
            self.armed = False

    def _turn(self, dt: float) -> None:
        axis, goal = self._heading, self._heading_goal_deg
        axis.step(goal, 0.0, dt, 1.0, self._turn_deg_s)
        if abs(axis.angle_deg - goal) < _AT_REST_DEG and abs(axis.rate_deg_s) < _AT_REST_DEG:
            axis.place(goal)  # skip the loop for the rest of the hover

    def true_yaw_deg(self) -> float:
        """Current heading (the part of `state` that the physics needs at every step)."""
        heading = self._heading.angle_deg
        if not self.is_flying:
            return heading
        c = self.config
        push = c.heading_offset_deg * (self.wind_m_s / _LEAN_REFERENCE_M_S) ** 2
        offset = push * math.sin(2 * math.radians(c.wind_from_deg - heading))
        return heading + offset + c.heading_sway_deg * self._sway_yaw.at(self._time_s)

    def state(self) -> AirframeState:
        """The current true state."""
        if self._state is None:
            self._state = self._make_state()
        return self._state

    def _make_state(self) -> AirframeState:
        t, c = self._time_s, self.config
        flying = 1.0 if self.is_flying else 0.0
        rough = flying * c.sway_deg * (1 + self.wind_m_s / 5)
        yaw = self.true_yaw_deg()
        towards = math.radians(c.wind_from_deg - yaw)
        hold = flying * c.hold_m * (1 + self.wind_m_s / 5)
        north, east, up = (hold * drift.at(t) for drift in self._hold)
        gps_north, gps_east, gps_up = (flying * c.gps_wander_m * drift.at(t) for drift in self._gps)
        return AirframeState(
            roll_deg=self._lean_deg * math.sin(towards) + rough * self._sway_roll.at(t),
            pitch_deg=-self._lean_deg * math.cos(towards) + rough * self._sway_pitch.at(t),
            yaw_deg=yaw,
            roll_rate_deg_s=rough * self._sway_roll.rate_at(t),
            pitch_rate_deg_s=rough * self._sway_pitch.rate_at(t),
            yaw_rate_deg_s=self._heading.rate_deg_s + flying * c.heading_sway_deg * self._sway_yaw.rate_at(t),
            north_m=self._away_m[0] + north - gps_north,
            east_m=self._away_m[1] + east - gps_east,
            up_m=self._height_m + 0.5 * up - 1.5 * gps_up,
        )

    def position(self) -> Position:
        """The current GPS position."""
        t, c = self._time_s, self.config
        hold = c.hold_m * (1 + self.wind_m_s / 5) if self.is_flying else 0.0
        north, east, up = (hold * drift.at(t) for drift in self._hold)
        up = self._height_m + 0.5 * up
        velocity = [hold * drift.rate_at(t) for drift in self._hold]
        if self._speed_m_s:
            velocity = [v + self._speed_m_s * part for v, part in zip(velocity, (*self._direction(), 0.0), strict=True)]
        north, east = north + self._away_m[0], east + self._away_m[1]
        return Position(
            latitude_deg=c.latitude_deg + north / METRES_PER_DEG,
            longitude_deg=c.longitude_deg + east / (METRES_PER_DEG * math.cos(math.radians(c.latitude_deg))),
            altitude_m=c.home_altitude_m + up,
            relative_altitude_m=up,
            velocity_m_s=(velocity[0], velocity[1], -self._climb_m_s),
        )
