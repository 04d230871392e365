"""Every number of the simulated vehicle, with its default; docs/simulator.md lists them for users."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

from panoexec.optics import Camera
from panoexec.sim.faults import FaultSpec

AutopilotKind: TypeAlias = Literal["ardupilot", "px4"]
MountKind: TypeAlias = Literal["mavlink", "servo"]
CameraKind: TypeAlias = Literal["mavlink", "servo"]

DEFAULT_PORTS = (14540, 14550)
"""Where programs and where ground stations listen by custom."""

DEFAULT_CAMERA = Camera(
    name="simulated",
    sensor_width_mm=17.3,
    sensor_height_mm=13.0,
    image_width_px=5280,
    image_height_px=3956,
    focal_length_mm=15.0,
)
"""A four-thirds camera with 15 mm: 60.0° x 46.9°, the paper's first scenario."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisConfig:
    """One axis of the gimbal: what its motor can do and where its stops are.

    Attributes:
        rate_deg_s: largest speed.
        acceleration_deg_s2: largest acceleration of a commanded move.
        min_deg, max_deg: range of commands that the gimbal accepts (yaw: relative to the vehicle's nose).
        noise_deg: standard deviation of the encoder, white, every report.
    """

    rate_deg_s: float
    acceleration_deg_s2: float
    min_deg: float
    max_deg: float
    noise_deg: float = 0.017


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalConfig:
    """The gimbal's mechanics and sensors.

    The encoder noise (0.017°) and the compass (0.667°) are the paper's accuracies of roll/pitch and yaw; rates and
    accelerations are those the planner assumes (`panoexec.planning.model.GimbalLimits`).

    Attributes:
        yaw, roll, pitch: the axes, outermost first.
        yaw_endless: whether yaw may turn through ±180° of the nose without end (then yaw's limits do not bind).
        stop_margin_deg: how far beyond the command range the mechanical stops are.
        loop_hz: natural frequency of the position loop.
        damping: of the position loop; below 1 it overshoots.
        feedforward_frac: how much of a move's acceleration the loop knows beforehand; 1 = no overshoot at all.
        heading_error_deg: bound of the error of the heading that the yaw angle is based on (compass); it drifts within
            it and cannot be seen in any report.
        heading_period_s: shortest period of that drift.
        gust_deg_s2: angular acceleration, standard deviation, that wind of 10 m/s puts on the camera; grows with the
            square of the wind.
        gust_corner_hz: above this frequency gusts have no strength.
    """

    yaw: AxisConfig = AxisConfig(rate_deg_s=90.0, acceleration_deg_s2=360.0, min_deg=-180.0, max_deg=180.0)
    roll: AxisConfig = AxisConfig(rate_deg_s=60.0, acceleration_deg_s2=240.0, min_deg=-45.0, max_deg=45.0)
    pitch: AxisConfig = AxisConfig(rate_deg_s=60.0, acceleration_deg_s2=240.0, min_deg=-90.0, max_deg=90.0)
    yaw_endless: bool = True
    stop_margin_deg: float = 3.0
    loop_hz: float = 4.0
    damping: float = 0.7
    feedforward_frac: float = 0.8
    heading_error_deg: float = 0.667
    heading_period_s: float = 90.0
    gust_deg_s2: float = 40.0
    gust_corner_hz: float = 1.5

    @property
    def pans(self) -> bool:
        """Whether it has a yaw axis: with a pan range of 0 it has two axes and looks where the vehicle's nose does."""
        return self.yaw_endless or self.yaw.max_deg > self.yaw.min_deg


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraConfig:
    """The camera: optics, timing, storage.

    Attributes:
        optics: sensor, lens and full image size, as told in CAMERA_INFORMATION.
        render_width_px: width of the JPEGs really written; height follows, and so does the time they take.
        exposure_s: shutter time.
        latency_s: from the command to the opening of the shutter.
        report_s: from the closing of the shutter to CAMERA_IMAGE_CAPTURED.
        interval_s: least time between two photos; a command within it is refused.
        storage_mib: size of the card.
        image_mib: what one photo takes of it.
        index_start: image index of the first photo.
        clock_rate: camera seconds per second: below 1 its clock runs slow.
        clock_step_s: by how much its clock is stepped, once; negative is back.
        clock_step_at_s: when that happens, in the camera's seconds since boot.
    """

    optics: Camera = DEFAULT_CAMERA
    render_width_px: int = 800
    exposure_s: float = 0.01
    latency_s: float = 0.05
    report_s: float = 0.05
    interval_s: float = 1.0
    storage_mib: float = 65536.0
    image_mib: float = 12.0
    index_start: int = 1
    clock_rate: float = 1.0
    clock_step_s: float = 0.0
    clock_step_at_s: float = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AirframeConfig:
    """The vehicle: where it hovers, how the wind moves it, how its battery drains.

    Attributes:
        latitude_deg, longitude_deg: home.
        home_altitude_m: above mean sea level.
        height_m: above home while it hovers.
        heading_deg: true heading while it hovers.
        wind_m_s: steady wind.
        wind_from_deg: direction that the wind blows from.
        lean_deg: how far the vehicle leans against wind of 8 m/s; grows with its square.
        sway_deg: standard deviation of roll and pitch about the mean in calm air.
        heading_sway_deg: standard deviation of the heading.
        heading_offset_deg: how far the nose may stand off the heading that it was told in wind of 8 m/s, by the wind's
            direction (ArduCopter's SITL: up to 2° for many seconds); grows with the wind's square.
        turn_rate_deg_s: largest speed of a turn on the spot.
        turn_acceleration_deg_s2: largest acceleration of one.
        turn_loop_hz: natural frequency of the heading's control loop.
        hold_m: standard deviation of the true position about the hover point in calm air.
        gps_wander_m: standard deviation of the slow error of the GPS: the vehicle holds the place that it is told, so
            it is the true position that wanders.
        battery_frac: charge at the start.
        battery_minutes: from full to empty.
        in_air: start hovering and armed; otherwise on the ground, disarmed.
        attitude_noise_deg: standard deviation of the reported roll, pitch and yaw.
    """

    latitude_deg: float = 47.397742
    longitude_deg: float = 8.545594
    home_altitude_m: float = 488.0
    height_m: float = 30.0
    heading_deg: float = 20.0
    wind_m_s: float = 2.0
    wind_from_deg: float = 250.0
    lean_deg: float = 14.0
    sway_deg: float = 0.3
    heading_sway_deg: float = 0.5
    heading_offset_deg: float = 1.5
    turn_rate_deg_s: float = 60.0
    turn_acceleration_deg_s2: float = 120.0
    turn_loop_hz: float = 0.8
    hold_m: float = 0.15
    gps_wander_m: float = 0.6
    battery_frac: float = 0.95
    battery_minutes: float = 25.0
    in_air: bool = True
    attitude_noise_deg: float = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class SimConfig:
    """A simulated vehicle, or with `attach_url` only its payload.

    Attributes:
        host, port: where the vehicle sends its messages (a ground station or MAVSDK listens there), or with `listen`
            where it waits for them. Without a port it sends to both of `DEFAULT_PORTS`, as PX4's SITL does.
        listen: wait on `port` for whoever talks first, instead of sending to it.
        autopilot: whose habits to show.
        mount: `mavlink`: a gimbal device of its own (ArduPilot's MNT1_TYPE 6); `servo`: driven by the autopilot, which
            reports the demanded angles relative to the airframe (MNT1_TYPE 1).
        camera_kind: `mavlink`: component 100 with its own messages; `servo`: a trigger on the autopilot (component 1)
            whose only proof is CAMERA_FEEDBACK.
        scene: equirectangular image to photograph; None for the procedural one.
        seed: of everything random.
        speedup: simulated seconds a second.
        faults: what goes wrong, see `panoexec.sim.faults`.
        output: directory for images and truth log; None writes no images.
        attach_url: `tcp:HOST:PORT`, `udpout:HOST:PORT` or `udpin:HOST:PORT` of an autopilot to join with the payload.
        system_id: of the vehicle.
        payload_boot_s: how long after the autopilot the payload booted; its boot clock counts from there.
        step_s: of the physics.
    """

    host: str = "127.0.0.1"
    port: int | None = None
    listen: bool = False
    autopilot: AutopilotKind = "ardupilot"
    mount: MountKind = "mavlink"
    camera_kind: CameraKind = "mavlink"
    scene: Path | None = None
    seed: int = 1
    speedup: float = 1.0
    faults: tuple[FaultSpec, ...] = ()
    output: Path | None = None
    attach_url: str | None = None
    system_id: int = 1
    payload_boot_s: float = 0.25
    step_s: float = 0.005
    gimbal: GimbalConfig = field(default_factory=GimbalConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    airframe: AirframeConfig = field(default_factory=AirframeConfig)
