"""The camera on a shutter cable whose contact a real autopilot closes (CAM1_TYPE 1 or 2).

A payload on a serial port does not see the servo's or relay's signal. It sees CAMERA_FEEDBACK (180), which the
autopilot sends on all its links at the trigger, and exposes then. It sends no messages itself, not even a heartbeat.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import Faults
from panoexec.sim.mavlink.camera_component import Fix, apply_drift_fault, gimbal_state
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.wire import Message
from panoexec.sim.physics.camera import CameraModel, Exposure
from panoexec.sim.physics.following import TIME_RESOLUTION_S
from panoexec.sim.physics.gimbal import GimbalPhysics
from panoexec.sim.physics.world import Timeline


class ReleasedCamera:
    """Exposes whenever the autopilot reports a trigger.

    Attributes:
        model: shutter and storage.
    """

    def __init__(
        self,
        config: SimConfig,
        *,
        timeline: Timeline,
        physics: GimbalPhysics,
        faults: Faults,
        develop: Callable[[Exposure, Fix], str],
    ) -> None:
        self._timeline = timeline
        self._physics = physics
        self._faults = faults
        self._develop = develop
        self._fix: Fix | None = None
        self.model = CameraModel(
            config.camera,
            timeline,
            look=lambda: gimbal_state(physics, timeline.now_s),
            on_exposed=self._exposed,
            time_resolution_s=TIME_RESOLUTION_S,
        )

    def receive(self, message: Message) -> None:
        """Handle a message of the link."""
        if message.get_type() != "CAMERA_FEEDBACK" or message.get_srcComponent() != mavlink.MAV_COMP_ID_AUTOPILOT1:
            return
        self._faults.photo_commanded(self._timeline.now_s)
        self._fix = Fix(
            latitude_deg=message.lat / 1e7,
            longitude_deg=message.lng / 1e7,
            altitude_m=message.alt_msl,
            relative_altitude_m=message.alt_rel,
            heading_deg=math.nan,
        )
        self.model.shoot()
        apply_drift_fault(self._faults, self._physics)

    def _exposed(self, exposure: Exposure) -> None:
        assert self._fix is not None
        self._develop(exposure, self._fix)
