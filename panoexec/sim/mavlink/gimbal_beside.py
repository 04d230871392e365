"""What there may be beside a gimbal: a manager of its own, a second gimbal, a component that tells wrong attitudes."""

from __future__ import annotations

import math
from collections.abc import Callable

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import Faults
from panoexec.sim.mavlink.component import NAN, Command, Component, command_of
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.manager import GimbalManager
from panoexec.sim.mavlink.wire import Link, Message, Sender
from panoexec.sim.physics.gimbal import Angles, GimbalPhysics, quaternion
from panoexec.sim.physics.world import Repeater, Timeline

SECOND_COMPONENT = mavlink.MAV_COMP_ID_GIMBAL2
STRANGER_COMPONENT = 155
_ATTITUDE_S = 0.02
_STATUS_S = 0.2
_LOOKS_AROUND_S = 20.0
_FLAGS = (
    mavlink.GIMBAL_DEVICE_FLAGS_ROLL_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
)


class OwnManager:
    """A gimbal manager in the gimbal's own component: it offers itself, and obeys only if the autopilot does not."""

    def __init__(
        self, config: SimConfig, *, component: Component, manager: GimbalManager, timeline: Timeline, obeys: bool
    ) -> None:
        """Create it.

        Args:
            config: of the vehicle.
            component: the gimbal's.
            manager: its state and messages.
            timeline: of the simulation.
            obeys: whether it is in charge; else it refuses, and names the autopilot as in control.
        """
        self._component = component
        self._manager = manager
        self._obeys = obeys
        if not obeys:
            manager.primary = (config.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        component.builders.update(
            {
                mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION: manager.information,
                mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: manager.status,
            }
        )
        self._status = Repeater(timeline, lambda: component.send(manager.status()))

    def start(self) -> None:
        """Stream its status."""
        self._status.start(_STATUS_S)

    def command(self, command: Command) -> int | None:
        """MAV_RESULT of a command to a manager; None for other commands."""
        if command.id not in (mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE):
            return None
        return self._manager.command(command) if self._obeys else int(mavlink.MAV_RESULT_FAILED)


class SecondGimbal:
    """Another gimbal on the vehicle, component 171, that pans by itself all the time and is not ours."""

    def __init__(self, config: SimConfig, *, timeline: Timeline, link: Link) -> None:
        self._timeline = timeline
        self._component = Component(
            timeline=timeline, sender=Sender(config.system_id, SECOND_COMPONENT), link=link, heartbeat=_gimbal_heartbeat
        )
        self._component.builders[mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS] = self.attitude_status
        self._stream = Repeater(timeline, lambda: self._component.send(self.attitude_status()))

    def start(self) -> None:
        """Start heartbeat and attitude stream."""
        self._component.start(phase_s=0.4)
        self._stream.start(_ATTITUDE_S)

    def attitude_status(self) -> Message:
        """GIMBAL_DEVICE_ATTITUDE_STATUS (285) of a slow look around."""
        yaw = 90.0 * math.sin(2 * math.pi * self._timeline.now_s / _LOOKS_AROUND_S)
        return _status(round(self._timeline.now_s * 1000), quaternion(Angles(yaw, 0.0, -20.0)))

    def receive(self, message: Message) -> None:
        """Answer commands."""
        if self._component.is_addressed(message) and (command := command_of(message)) is not None:
            result = self._component.common_command(command, unknown_message=mavlink.MAV_RESULT_UNSUPPORTED)
            self._component.acknowledge(command, mavlink.MAV_RESULT_UNSUPPORTED if result is None else result)


class Stranger:
    """A component that tells the attitude of the target as soon as the gimbal itself falls silent."""

    def __init__(
        self, config: SimConfig, *, timeline: Timeline, physics: GimbalPhysics, faults: Faults, link: Link
    ) -> None:
        self._timeline = timeline
        self._physics = physics
        self._faults = faults
        self._component = Component(
            timeline=timeline,
            sender=Sender(config.system_id, STRANGER_COMPONENT),
            link=link,
            heartbeat=_gimbal_heartbeat,
        )
        self._stream = Repeater(timeline, self._tell)

    def start(self) -> None:
        """Start heartbeat and lies."""
        self._component.start(phase_s=0.5)
        self._stream.start(_ATTITUDE_S)

    def _tell(self) -> None:
        if not self._faults.active("attitude-stop", self._timeline.now_s):
            return
        target = self._physics.target
        yaw = target.yaw_deg - (self._physics.nose_deg if target.yaw_lock else 0.0)
        q = quaternion(Angles(yaw, target.roll_deg, target.pitch_deg))
        self._component.send(_status(round(self._timeline.now_s * 1000), q))


def own_manager(
    config: SimConfig,
    *,
    component: Component,
    physics: GimbalPhysics,
    timeline: Timeline,
    obey: Callable[[Message], None],
) -> OwnManager | None:
    """The gimbal's own manager, if it has one."""
    if config.gimbal_beside not in ("manager", "only-manager"):
        return None
    manager = GimbalManager(
        config,
        physics=physics,
        boot_ms=lambda: round(timeline.now_s * 1000),
        airframe_state=None,
        to_device=obey,
        changed=component.send,
        device_id=int(mavlink.MAV_COMP_ID_GIMBAL),
    )
    obeys = config.gimbal_beside == "only-manager"
    return OwnManager(config, component=component, manager=manager, timeline=timeline, obeys=obeys)


def _status(boot_ms: int, q: tuple[float, ...]) -> Message:
    return mavlink.MAVLink_gimbal_device_attitude_status_message(
        0, 0, boot_ms, _FLAGS, q, NAN, NAN, NAN, 0, NAN, NAN, 0
    )


def _gimbal_heartbeat() -> Message:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )
