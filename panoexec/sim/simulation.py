"""All parts of one simulated vehicle, advanced in simulated time. No sockets, no event loop, no wall clock."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import Faults
from panoexec.sim.mavlink.camera_component import Fix
from panoexec.sim.mavlink.payload import Payload
from panoexec.sim.mavlink.px4_trigger import Px4Trigger
from panoexec.sim.mavlink.trigger import CameraTrigger
from panoexec.sim.mavlink.vehicle import THIEF, Vehicle
from panoexec.sim.mavlink.wire import Link, LocalLink, Message, Receiver
from panoexec.sim.photos.darkroom import ExposedPhoto
from panoexec.sim.photos.exposure import Settings
from panoexec.sim.photos.mixer import PhotoMixer
from panoexec.sim.physics.airframe import Airframe
from panoexec.sim.physics.camera import Exposure
from panoexec.sim.physics.gimbal import GimbalPhysics, quaternion
from panoexec.sim.physics.world import Repeater, SimClock, Timeline, TruthLog
from panoexec.sim.tethered.shutter import TetheredShutter

_CHUNK_S = 0.02
"""Longest wall time between two polls of the sockets."""
_FAULT_S = 0.02
_HEADING_HOLD_S = 0.2
_SWAP_S = 6.0


class Simulation:
    """The vehicle with its payload, or the payload only, with one external link.

    Attributes:
        timeline: the scheduled events.
        vehicle: the embedded autopilot, None when only the payload is simulated.
        payload: gimbal and camera components.
        receiver: handler of the link's messages.
    """

    receiver: Receiver

    def __init__(
        self,
        config: SimConfig,
        *,
        clock: SimClock,
        link: Link,
        truth: TruthLog,
        develop: Callable[[ExposedPhoto], None] | None = None,
        file_url: Callable[[Path], str] = Path.as_uri,
        definition_uri: str = "",
    ) -> None:
        self.config = config
        self.clock = clock
        self.timeline = Timeline()
        self.faults = Faults(config.faults, seed=config.seed)
        self.physics = GimbalPhysics(config.gimbal, seed=config.seed, step_s=config.step_s)
        self.airframe = Airframe(config.airframe, seed=config.seed)
        self.vehicle: Vehicle | None = None
        self._file_url = file_url
        self._definition_uri = definition_uri
        self._mixer = PhotoMixer(self.faults, develop or (lambda _: None))
        self._renders = develop is not None
        self._truth = truth
        self._steps = 0
        self._photos = 0
        self._first_number = _next_number(config.output)
        if config.attach_url is None:
            inner, outer = LocalLink.pair("payload", "vehicle")
            self.payload = self._make_payload(inner)
            self.vehicle = self._make_vehicle(link, outer)
            inner.receiver, outer.receiver = self.payload.receive, self.vehicle.receive_payload
            self.receiver = self.vehicle.receive_ground
        else:
            self.payload = self._make_payload(link)
            self.receiver = self.payload.receive
        self.tethered: TetheredShutter | None = None
        if config.camera_link == "gphoto2":
            self.tethered = TetheredShutter(
                config,
                clock=clock,
                timeline=self.timeline,
                physics=self.physics,
                faults=self.faults,
                develop=self._develop_with,
            )
        self.physics.start_at(self._heading())
        Repeater(self.timeline, self._apply_faults).start(_FAULT_S)

    def _make_payload(self, link: Link) -> Payload:
        return Payload(
            self.config,
            clock=self.clock,
            timeline=self.timeline,
            physics=self.physics,
            faults=self.faults,
            link=link,
            develop=self._develop,
            definition_uri=self._definition_uri,
        )

    def _make_vehicle(self, ground: Link, bus: Link) -> Vehicle:
        trigger = None
        if self.config.camera_kind != "mavlink":
            kind = Px4Trigger if self.config.camera_kind == "px4-trigger" else CameraTrigger
            trigger = kind(
                self.config,
                clock=self.clock,
                timeline=self.timeline,
                physics=self.physics,
                faults=self.faults,
                develop=self._develop,
            )
        return Vehicle(
            self.config,
            clock=self.clock,
            timeline=self.timeline,
            airframe=self.airframe,
            physics=self.physics,
            faults=self.faults,
            ground=ground,
            payload=bus,
            trigger=trigger,
        )

    def start(self) -> None:
        """Start all components and simulated time."""
        self._truth.write("start", 0.0, {"seed": self.config.seed, "camera": asdict(self.config.camera.optics)})
        if self.vehicle is not None:
            self.vehicle.start()
            if self.config.mount == "mavlink":
                self.payload.start_gimbals()
            if self.config.camera_kind == "mavlink" and self.tethered is None:
                self.payload.start_camera()
        elif self.tethered is None:
            self.payload.start()
        else:
            self.payload.start_gimbals()

    @property
    def hold_s(self) -> float:
        """Simulated time that must not pass yet, where a parent sets the pace: a photo is being rendered."""
        return math.inf if self.tethered is None else self.tethered.hold_s

    @property
    def photos(self) -> int:
        """Exposures made so far."""
        return self._photos

    def _flush_if_last(self, count: int) -> None:
        if count == self._photos:
            self.flush_photos()

    def flush_photos(self) -> None:
        """Have photos rendered that wait for a later one (fault `photo-swapped`)."""
        self._mixer.flush()

    def _heading(self) -> float:
        """The vehicle's heading as its autopilot estimates it."""
        if self.vehicle is not None:
            return self.airframe.true_yaw_deg() + self.physics.heading_error_deg
        gimbal = self.payload.gimbal
        if math.isnan(gimbal.vehicle_yaw_deg):  # not received yet
            return 0.0
        age = min(self.timeline.now_s - gimbal.vehicle_yaw_time_s, _HEADING_HOLD_S)
        return gimbal.vehicle_yaw_deg + gimbal.vehicle_yaw_rate_deg_s * age

    def forwards(self, message: Message) -> bool:
        """Whether a message from one peer on the ground goes on to the others."""
        return self.vehicle is not None and self.vehicle.forwards(message)

    def advance(self, to_s: float, *, budget_s: float = _CHUNK_S) -> None:
        """Run physics and events up to simulated time `to_s`, limited to `budget_s` of wall time."""
        step, timeline = self.config.step_s, self.timeline
        deadline = time.monotonic() + budget_s
        while True:
            next_step = (self._steps + 1) * step
            if next_step > to_s:
                break
            timeline.run_until(next_step - 1e-9)
            self._steps += 1
            self.airframe.step(step)
            self.physics.step(self._heading())
            if self._steps % 16 == 0 and time.monotonic() > deadline:
                return
        timeline.run_until(to_s)

    @property
    def next_s(self) -> float:
        """Time of the next event; the physics up to it is computed then."""
        return self.timeline.next_s

    def _apply_faults(self) -> None:
        faults, now = self.faults, self.timeline.now_s
        self.physics.stuck = faults.active("gimbal-stuck", now)
        self.physics.slowness = faults.size("gimbal-slow") if faults.active("gimbal-slow", now) else 1.0
        wind = self.config.airframe.wind_m_s + (faults.size("gust") if faults.active("gust", now) else 0.0)
        self.physics.wind_m_s = self.airframe.wind_m_s = wind
        full = faults.active("storage-full", now)
        self.payload.camera.set_storage_full(full=full)
        if self.tethered is not None:
            self.tethered.model.storage_full = full
        if faults.fires("clock-jump", now):
            self.clock.jump_s += faults.size("clock-jump")
        if faults.fires("battery-low", now):
            self.airframe.battery_frac = faults.size("battery-low")
        vehicle = self.vehicle
        if vehicle is not None:
            if faults.fires("reboot", now):
                vehicle.reboot(faults.size("reboot"))
            if faults.fires("control-stolen", now):
                vehicle.manager.steal(THIEF)
            if faults.fires("mode-change", now):
                vehicle.modes.set(vehicle.modes.pilot_mode)
            if faults.fires("rtl", now):
                vehicle.return_to_launch()
            vehicle.lose_gps(lost=faults.active("gps-lost", now))

    def _develop_with(self, exposure: Exposure, settings: Settings) -> str:
        return self._develop(exposure, self.payload.camera.fix, settings)

    def _develop(self, exposure: Exposure, fix: Fix | None, settings: Settings | None = None) -> str:
        """Queue a photo for rendering and log its true attitude; returns the file's URL."""
        settings = settings or Settings(exposure_s=self.config.camera.exposure_s)
        output = self.config.output
        self._photos += 1
        # not by the index, which a camera that restarts uses twice
        name = f"IMG_{self._first_number + self._photos - 1:05d}.jpg"
        exposure = self._mixer.turned(exposure)
        spoiled = self._mixer.names()
        nose = self.physics.nose_deg
        self._truth.write(
            "exposure",
            exposure.start_s,
            {
                "image_index": exposure.index,
                "file": name,
                "end_s": round(exposure.end_s, 4),
                "true_yaw_roll_pitch_deg": [list(angles) for angles in exposure.truth],
                "estimated_yaw_roll_pitch_deg": list(exposure.estimate),
                "measured_yaw_roll_pitch_deg": list(exposure.measured),
                "heading_error_deg": self.physics.heading_error_deg,
                "vehicle_heading_deg": nose,
                "target": asdict(self.physics.target),
                "wind_m_s": self.physics.wind_m_s,
            }
            | ({"faults": spoiled} if spoiled else {}),
        )
        if output is None or not self._renders:
            return name
        path = output.absolute() / name
        # a photo that waits for another one to be swapped with does not wait for ever
        self.timeline.after(_SWAP_S, functools.partial(self._flush_if_last, self._photos))
        self._mixer.develop(
            ExposedPhoto(
                path=str(path),
                truth_deg=tuple((a.yaw_deg, a.roll_deg, a.pitch_deg) for a in exposure.truth),
                q_wxyz=quaternion(exposure.measured),
                time_utc_s=self.clock.utc(exposure.start_s),
                exposure_s=settings.exposure_s,
                f_number=settings.f_number,
                iso=settings.iso,
                manual_white_balance=settings.manual_white_balance,
                position=None
                if fix is None
                else (fix.latitude_deg, fix.longitude_deg, fix.altitude_m, fix.relative_altitude_m),
                flight_yaw_deg=nose,
            )
        )
        return self._file_url(path)


def _next_number(output: Path | None) -> int:
    """The first photo number that does not overwrite a file of an earlier run."""
    if output is None:
        return 1
    taken = [int(path.stem[4:]) for path in output.glob("IMG_*.jpg") if path.stem[4:].isdigit()]
    return max(taken, default=0) + 1
