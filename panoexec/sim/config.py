"""Every parameter of the simulated vehicle, with its default; docs/simulator.md lists them for users."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias

from panoexec.optics import Camera
from panoexec.sim.faults import FaultSpec

AutopilotKind: TypeAlias = Literal["ardupilot", "px4"]
MountKind: TypeAlias = Literal["mavlink", "servo", "driver", "echo"]
GimbalBeside: TypeAlias = Literal["none", "manager", "only-manager", "second", "stranger"]
CameraKind: TypeAlias = Literal["mavlink", "servo", "px4-trigger"]
CameraFiles: TypeAlias = Literal["folder", "http", "mftp"]
CameraDefinition: TypeAlias = Literal["none", "http", "mftp"]
SceneKind: TypeAlias = Literal["city", "lake", "snow", "night"]
CameraLink: TypeAlias = Literal["mavlink", "gphoto2"]
CameraBeside: TypeAlias = Literal["none", "streamer", "camera"]

SCENE_KINDS: tuple[SceneKind, ...] = ("city", "lake", "snow", "night")
DEFAULT_PORTS = (14540, 14550)
"""The usual UDP ports of MAVSDK and of ground stations."""

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
    """One axis of the gimbal: motor performance and end stops.

    Attributes:
        rate_deg_s: maximum rate.
        acceleration_deg_s2: maximum acceleration of a commanded move.
        min_deg, max_deg: range of accepted commands (yaw: relative to the vehicle's nose).
        noise_deg: standard deviation of the encoder noise, white, in every report.
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
        yaw_endless: whether yaw rotates continuously through ±180° of the nose (then yaw's limits do not apply).
        stop_margin_deg: distance of the mechanical stops beyond the command range.
        loop_hz: natural frequency of the position loop.
        damping: damping ratio of the position loop; below 1 it overshoots.
        feedforward_frac: fraction of a move's acceleration that is fed forward to the loop; 1 = no overshoot.
        heading_error_deg: bound of the error of the heading that the yaw angle is based on (compass); it drifts within
            the bound and does not appear in any report.
        heading_period_s: shortest period of that drift.
        gust_deg_s2: standard deviation of the camera's angular acceleration in wind of 10 m/s; proportional to the
            square of the wind speed.
        gust_corner_hz: corner frequency of the gusts.
        rate_noise_deg_s: standard deviation of the noise of its gyroscopes, white, in every reported rate.
        report_hz: rate of the attitude reports that it sends by itself.
        report_obeys: it sends more or fewer of them when its component is asked to.
        report_step_deg: step of reported angles; 0: none.
        report_age_s: age of what is reported, with a mount of the kind `driver`.
        report_target: it reports its target instead of what it measures.
        steady_error_deg: pitch and yaw by which it rests beside its commands.
        pitch_bias_deg: constant error of its pitch, measured minus true, which no report shows.
        roll_bias_deg: likewise of its roll.
        north_off_deg: the north that it obeys, and that its reports are relative to, is so far off; 0: its reports are
            relative to the vehicle.
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
    rate_noise_deg_s: float = 0.05
    report_hz: float = 50.0
    report_obeys: bool = True
    report_step_deg: float = 0.0
    report_age_s: float = 0.0
    report_target: bool = False
    steady_error_deg: float = 0.0
    pitch_bias_deg: float = 0.0
    roll_bias_deg: float = 0.0
    north_off_deg: float = 0.0

    @property
    def pans(self) -> bool:
        """Whether the gimbal has a pan axis; with a pan range of 0 it has two axes and points along the nose."""
        return self.yaw_endless or self.yaw.max_deg > self.yaw.min_deg


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraConfig:
    """The camera: optics, timing, storage.

    Attributes:
        optics: sensor, lens and full image size, as reported in CAMERA_INFORMATION.
        render_width_px: width of the JPEGs that are written; their height and rendering time follow from it.
        exposure_s: shutter time.
        latency_s: delay from the command to the opening of the shutter.
        report_s: delay from the closing of the shutter to CAMERA_IMAGE_CAPTURED.
        interval_s: minimum interval between two photos; an earlier command is rejected.
        storage_mib: size of the card.
        image_mib: size of one photo on the card.
        index_start: image index of the first photo.
        clock_rate: camera seconds per second: below 1 its clock runs slow.
        clock_step_s: by how much its clock is stepped, once; negative is back.
        clock_step_at_s: when that happens, in the camera's seconds since boot.
        latency_jitter_s: what the shutter is later than `latency_s` by, at random from 0 to this.
        queue: photo commands that it accepts while it is busy and carries out when it can; 0: it rejects them.
        starts_in_video: it is in video mode when it is switched on, and denies photos until its mode is changed.
        refuses_modes: it denies every change of its mode.
        silent_every: every n-th photo is neither reported nor told on request; 0: none.
        reset_after: it restarts after so many photos: index and clock begin anew; 0: never.
        undated: its reports have no time since boot.
        trigger_min_s: least time between two triggers of the autopilot's shutter (CAM1_INTRVAL_MIN); an earlier one is
            carried out later.
        trigger_fails: an autopilot answers such a trigger with FAILED, and carries it out later all the same.
        trigger_min_told: the autopilot tells that parameter.
        files: where its reports say that its photos are: in a `folder` of this computer, on its server at loopback
            (`http`), or served by MAVLink FTP (`mftp`).
        file_kb: least size of a photo's file, in kB: comments in it fill the rest.
        files_kb_s: how fast it serves them by HTTP, in kB/s; 0: at once.
        definition: where it says that its camera definition is: `none`, on its server at loopback (`http`), or served
            by MAVLink FTP (`mftp`). With one, its settings can be made, and until then it meters each photo by itself.
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
    latency_jitter_s: float = 0.0
    queue: int = 0
    starts_in_video: bool = False
    refuses_modes: bool = False
    silent_every: int = 0
    reset_after: int = 0
    undated: bool = False
    trigger_min_s: float = 0.0
    trigger_fails: bool = False
    trigger_min_told: bool = True
    files: CameraFiles = "folder"
    file_kb: float = 0.0
    files_kb_s: float = 0.0
    definition: CameraDefinition = "none"


@dataclass(frozen=True, slots=True, kw_only=True)
class AirframeConfig:
    """The vehicle: position, response to wind, battery.

    Attributes:
        latitude_deg, longitude_deg: home.
        home_altitude_m: above mean sea level.
        height_m: above home while it hovers.
        heading_deg: true heading while it hovers.
        wind_m_s: steady wind.
        wind_from_deg: direction that the wind blows from.
        lean_deg: tilt of the vehicle against wind of 8 m/s; proportional to the square of the wind speed.
        sway_deg: standard deviation of roll and pitch about the mean in calm air.
        heading_sway_deg: standard deviation of the heading.
        heading_offset_deg: deviation of the heading from its setpoint in wind of 8 m/s, depending on the wind's
            direction (ArduCopter's SITL: up to 2° for many seconds); proportional to the square of the wind speed.
        turn_rate_deg_s: maximum yaw rate of a turn on the spot.
        turn_acceleration_deg_s2: maximum yaw acceleration of a turn.
        turn_loop_hz: natural frequency of the heading's control loop.
        hold_m: standard deviation of the true position about the hover point in calm air.
        gps_wander_m: standard deviation of the slow error of the GPS: the vehicle holds the GPS position, so the true
            position wanders.
        battery_frac: state of charge at the start.
        battery_minutes: time from full to empty.
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
        host, port: destination of the vehicle's messages (a ground station or MAVSDK listens there), or with `listen`
            the address to listen on. Without a port it sends to both of `DEFAULT_PORTS`, as PX4's SITL does.
        listen: listen on `port` for a client instead of sending to it.
        autopilot: autopilot to emulate.
        mount: `mavlink`: a gimbal device of its own (ArduPilot's MNT1_TYPE 6); `servo`: driven by the autopilot, which
            reports the demanded angles relative to the airframe (MNT1_TYPE 1); `driver`: by a driver of the autopilot,
            which reports what it measured (MNT1_TYPE 8); `echo`: on outputs, and the autopilot reports the demanded
            angles (MNT1_TYPE 7, PX4's MNT_MODE_OUT 0).
        mount_told: the parameter that says so can be read.
        gimbal_beside: what there is beside the gimbal: a `manager` of its own that refuses, or the `only-manager` that
            obeys; a `second` gimbal; a `stranger` that tells attitudes when the gimbal is silent.
        camera_kind: `mavlink`: component 100 with its own messages; `servo`: a trigger on the autopilot (component 1)
            whose only evidence is CAMERA_FEEDBACK; `px4-trigger`: PX4's own trigger on an output, by
            MAV_CMD_DO_DIGICAM_CONTROL.
        camera_link: how the camera is reached: by MAVLink, or by `gphoto2`, as one that speaks PTP/IP on the network.
        camera_port: TCP port of the latter; 0: any free one.
        camera_beside: what there is beside the camera, as component 100, which makes the camera 101: a `streamer` of
            video that takes no photos, or another `camera`; only with `camera_kind` `mavlink`.
        scene: equirectangular image to photograph; None for the procedural one.
        scene_kind: what the procedural scene shows.
        seed: random seed.
        speedup: simulated seconds per second.
        faults: faults to inject, see `panoexec.sim.faults`.
        output: directory for images and ground-truth log; None writes no images.
        attach_url: `tcp:HOST:PORT`, `udpout:HOST:PORT` or `udpin:HOST:PORT` of an autopilot to attach the payload to.
        system_id: MAVLink system id of the vehicle.
        payload_boot_s: boot time of the payload after that of the autopilot; its boot clock starts then.
        step_s: time step of the physics.
    """

    host: str = "127.0.0.1"
    port: int | None = None
    listen: bool = False
    autopilot: AutopilotKind = "ardupilot"
    mount: MountKind = "mavlink"
    mount_told: bool = True
    gimbal_beside: GimbalBeside = "none"
    camera_kind: CameraKind = "mavlink"
    camera_link: CameraLink = "mavlink"
    camera_port: int = 15740
    camera_beside: CameraBeside = "none"
    scene: Path | None = None
    scene_kind: SceneKind = "city"
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
