"""The embedded autopilot: one MAVLink component (1) that routes between the ground and the payload.

Routing is as in ArduPilot: broadcasts of the payload go to the ground and vice versa; an addressed message goes to the
link on which the addressee was heard. No message is streamed until it is requested (PX4: a few by default); a reboot
resets all message intervals.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from panoexec.sim.config import SimConfig
from panoexec.sim.faults import Faults
from panoexec.sim.mavlink.auto_flight import AutoFlight
from panoexec.sim.mavlink.component import Command, Component, command_of
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.gated_link import GatedLink
from panoexec.sim.mavlink.held_up import HeldUp
from panoexec.sim.mavlink.manager import GimbalManager
from panoexec.sim.mavlink.mission_items import Item
from panoexec.sim.mavlink.modes import FlightModes
from panoexec.sim.mavlink.parameters import Parameters
from panoexec.sim.mavlink.telemetry import Telemetry
from panoexec.sim.mavlink.trigger import CameraTrigger
from panoexec.sim.mavlink.wire import Link, Message, Sender
from panoexec.sim.physics.airframe import Airframe
from panoexec.sim.physics.gimbal import GimbalPhysics
from panoexec.sim.physics.world import Repeater, SimClock, Timeline

COMPONENT_ID = mavlink.MAV_COMP_ID_AUTOPILOT1
THIEF = (255, 190)
"""System and component of the other ground station that takes the gimbal (fault `control-stolen`)."""

_PX4_STREAMS = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 50.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: 5.0,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
}
_ACCEPTED = int(mavlink.MAV_RESULT_ACCEPTED)
_DENIED = int(mavlink.MAV_RESULT_DENIED)
_REBOOT_S = 3.0
_PX4_LOOKS_S = 1.0
"""How long after its boot it looks for a gimbal."""
_PX4_RTL_S = (0.3, 0.8)
"""After a change to RTL it takes the gimbal, and drops it again (between two looks 0.2 s apart)."""
_FORCED_REBOOT = 20190226
"""Sixth parameter of a reboot that ArduPilot carries out while armed."""
_ESTIMATOR_S = 8.0
"""How long an estimator goes on without GPS; measured on ArduCopter."""
_TO_DEVICE_S = {"ardupilot": 0.02, "px4": 0.1}
_STATE_FOR_GIMBAL_US = 20_000


class Vehicle:
    """Autopilot, gimbal manager and router.

    Attributes:
        airframe: the vehicle's physics.
        manager: the gimbal manager.
        modes: flight modes.
    """

    def __init__(
        self,
        config: SimConfig,
        *,
        clock: SimClock,
        timeline: Timeline,
        airframe: Airframe,
        physics: GimbalPhysics,
        faults: Faults,
        ground: Link,
        payload: Link,
        trigger: CameraTrigger | None,
    ) -> None:
        self._config = config
        self._timeline = timeline
        self._faults = faults
        self._sender = Sender(config.system_id, COMPONENT_ID)
        self._heading_error_deg: Callable[[], float] = lambda: physics.heading_error_deg
        self._boot_s = 0.0
        self._silent_until_s = -math.inf
        self._gps_lost_s = math.inf
        self._estimator_failed = False
        self.airframe = airframe
        self.modes = FlightModes(config.autopilot)
        self._links = {"ground": ground, "payload": payload}
        self._ground_gate = GatedLink(ground, self._drops)
        self._ground_heard = False  # nothing is forwarded to the ground until a ground station was heard
        self._telemetry = Telemetry(
            config,
            clock=clock,
            now=lambda: timeline.now_s,
            boot_ms=self.boot_ms,
            airframe=airframe,
            heading_error_deg=self._heading_error_deg,
            modes=self.modes,
            has_fix=lambda: math.isinf(self._gps_lost_s),
            has_position=lambda: not self._estimator_failed,
        )
        self._ground = self._component(ground)
        self._payload = self._component(payload)
        self.manager = GimbalManager(
            config,
            physics=physics,
            boot_ms=self.boot_ms,
            airframe_state=airframe.state,
            to_device=self._payload.send if config.mount == "mavlink" else None,
            changed=self._ground.send,
        )
        self._trigger = trigger
        if trigger is not None:
            trigger.connect(boot_ms=self.boot_ms, airframe=airframe, send=self._ground.send)
        for component in (self._ground, self._payload):
            component.builders.update(self._telemetry.builders())
            component.builders.update(self._gimbal_builders())
            if trigger is not None:
                component.builders.update(trigger.builders())
        self.auto = AutoFlight(
            config,
            timeline=timeline,
            airframe=airframe,
            modes=self.modes,
            send=self._ground.send,
            say=self.say,
            do=self._do,
            home=self.return_to_launch,
            land=airframe.land,
        )
        for component in (self._ground, self._payload):
            component.builders[mavlink.MAVLINK_MSG_ID_MISSION_CURRENT] = self.auto.current
        self._parameters = Parameters(config)
        self._setters: dict[str, Callable[[Message], None]] = {
            "GIMBAL_MANAGER_SET_PITCHYAW": self.manager.set_pitchyaw,
            "GIMBAL_MANAGER_SET_ATTITUDE": self.manager.set_attitude,
            "RC_CHANNELS_OVERRIDE": self._telemetry.override_channels,
            "MISSION_SET_CURRENT": self.auto.take_current,
        }
        self._target_repeater = Repeater(timeline, self.manager.send_target)
        if config.mount == "driver":
            Repeater(timeline, self.manager.poll_driver).start(1 / config.gimbal.report_hz)

    def _component(self, link: Link) -> Component:
        gate = GatedLink(link, self._drops)
        return Component(timeline=self._timeline, sender=self._sender, link=gate, heartbeat=self._telemetry.heartbeat)

    def _gimbal_builders(self) -> dict[int, Callable[[], Message | None]]:
        held_up = HeldUp(self._faults)

        def attitude() -> Message | None:
            if self._faults.active("attitude-stop", self._timeline.now_s):
                return None
            return held_up.passed(self.manager.attitude_status(), self._timeline.now_s)

        return {
            mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION: self._manager_information,
            mavlink.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS: self.manager.status,
            mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS: attitude,
        } | (
            {mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION: self.manager.device_information}
            if self._config.autopilot == "px4"
            else {}
        )

    def _manager_information(self) -> Message:
        """GIMBAL_MANAGER_INFORMATION (280); as ArduPilot, it sends one for each gimbal that it drives."""
        if self._config.gimbal_beside == "second" and self._config.autopilot == "ardupilot":
            second = self.manager.information()
            second.gimbal_device_id = 2
            self._ground.send(second)
        return self.manager.information()

    def boot_ms(self) -> int:
        """Milliseconds since the autopilot's last boot."""
        return max(0, round((self._timeline.now_s - self._boot_s) * 1000))

    @property
    def is_silent(self) -> bool:
        """Whether it is rebooting."""
        return self._timeline.now_s < self._silent_until_s

    def start(self) -> None:
        """Start heartbeats and default streams."""
        self._ground.start(phase_s=0.0)
        self._payload.start(phase_s=0.1)
        self._start_streams()

    def _start_streams(self) -> None:
        if self._config.mount == "mavlink" and self._config.gimbal_beside != "only-manager":
            self._payload.streams.set_interval(
                mavlink.MAVLINK_MSG_ID_AUTOPILOT_STATE_FOR_GIMBAL_DEVICE, _STATE_FOR_GIMBAL_US
            )
            self._target_repeater.start(_TO_DEVICE_S[self._config.autopilot])
        if self._config.autopilot == "px4":
            if self._config.mount == "mavlink":
                # whoever is a gimbal answers
                self._timeline.after(_PX4_LOOKS_S, lambda: self._payload.send(_gimbal_wanted()))
            for message_id, rate_hz in _PX4_STREAMS.items():
                self._ground.streams.set_interval(message_id, 1e6 / rate_hz)

    def return_to_launch(self) -> None:
        """Change to RTL; PX4 takes the gimbal for it and drops it."""
        self.modes.set("RTL")
        if self._config.autopilot == "px4":
            took_s, dropped_s = _PX4_RTL_S
            self._timeline.after(took_s, self.manager.take)
            self._timeline.after(dropped_s, self.manager.drop)

    def reboot(self, silence_s: float) -> None:
        """Reboot: the motors stop; after a silence the initial state, disarmed in the mode of a boot."""
        self.airframe.stop_motors()
        self._silent_until_s = self._timeline.now_s + silence_s
        for component in (self._ground, self._payload):
            component.streams.clear()
        self._target_repeater.stop()

        def up() -> None:
            self._boot_s = self._timeline.now_s
            self.modes.set(self.modes.boot_mode)
            self._ground_heard = False
            self.manager.forget()
            self._start_streams()

        self._timeline.at(self._silent_until_s, up)

    def lose_gps(self, *, lost: bool) -> None:
        """The GPS has no fix, or has one (again); the estimator's failsafe lands after `_ESTIMATOR_S` without it."""
        now_s = self._timeline.now_s
        if not lost:
            self._gps_lost_s, self._estimator_failed = math.inf, False
            return
        self._gps_lost_s = min(self._gps_lost_s, now_s)
        if not self._estimator_failed and now_s - self._gps_lost_s >= _ESTIMATOR_S:
            self._estimator_failed = True
            self.modes.set(self.modes.land_mode)
            self.airframe.land()

    def receive_ground(self, message: Message, frame: bytes) -> None:
        """Handle a message from the ground."""
        if self.is_silent or self._faults.active("link-loss", self._timeline.now_s):
            return
        if message.get_srcSystem() == self._config.system_id and message.get_srcComponent() == COMPONENT_ID:
            return
        self._ground_heard = True
        target = getattr(message, "target_component", 0)
        if getattr(message, "target_system", 0) in (0, self._config.system_id):
            if target != COMPONENT_ID:
                self._links["payload"].send(frame, message)
            if target in (0, COMPONENT_ID):
                self._handle(self._ground, message)

    def forwards(self, message: Message) -> bool:
        """Whether a message from the ground goes on to others on the ground: it is not for the autopilot alone."""
        if self.is_silent or self.link_is_lost():
            return False
        return bool(getattr(message, "target_component", 0) != COMPONENT_ID)

    def receive_payload(self, message: Message, frame: bytes) -> None:
        """Handle a message from the payload's link."""
        if self.is_silent:
            return
        target = getattr(message, "target_component", 0)
        if target != COMPONENT_ID and self._ground_heard:
            self._ground_gate.send(frame, message)
        if target in (0, COMPONENT_ID):
            self._handle(self._payload, message)

    def link_is_lost(self) -> bool:
        """Whether the ground link is lost (fault)."""
        return self._faults.active("link-loss", self._timeline.now_s)

    def is_ground(self, link: Link) -> bool:
        """Whether a link leads to the ground."""
        return link is self._links["ground"]

    def _drops(self, link: Link) -> bool:
        """Whether nothing is sent on a link now: during a reboot, or on a lost link to the ground."""
        return self.is_silent or (self.is_ground(link) and self.link_is_lost())

    def _handle(self, source: Component, message: Message) -> None:
        kind = message.get_type()
        if kind.startswith("GIMBAL_DEVICE_"):
            self.manager.device_reported(message)
        elif kind in ("COMMAND_LONG", "COMMAND_INT"):
            command = command_of(message)
            assert command is not None
            if source.is_for_me(message):
                result = self._command(source, command)
                if result is not None:
                    source.acknowledge(command, result)
        elif kind in self._setters:
            self._setters[kind](message)
        elif kind == "TIMESYNC":
            if message.tc1 == 0:
                source.send(mavlink.MAVLink_timesync_message(self.boot_ms() * 1_000_000, message.ts1))
        else:
            answers = self.auto.store.answers(message)
            for answer in self._parameters.answers(message) if answers is None else answers:
                source.send(answer)

    def _command(self, source: Component, command: Command) -> int | None:
        """Execute a command; return the MAV_RESULT, or None for no acknowledgement."""
        unknown = mavlink.MAV_RESULT_FAILED if self._config.autopilot == "ardupilot" else mavlink.MAV_RESULT_DENIED
        if command.id == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL and self._sends_by_itself(command.params[0]):
            return int(mavlink.MAV_RESULT_FAILED)
        common = source.common_command(command, unknown_message=unknown)
        if common is not None:
            return common
        if command.id in (mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW, mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE):
            if self._config.gimbal_beside == "only-manager":
                return _DENIED
            return self.manager.command(command)
        if self._trigger is not None and command.id in self._trigger.commands:
            return self._trigger.command(command)
        return self._flight_command(command)

    def _sends_by_itself(self, message_id: float) -> bool:
        """Whether a message is one that PX4 sends at changes, and refuses an interval for."""
        return self._config.autopilot == "px4" and message_id == mavlink.MAVLINK_MSG_ID_MISSION_CURRENT

    def _flight_command(self, command: Command) -> int:
        actions: dict[int, Callable[[Command], int]] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_NAV_LAND: self._land,
            mavlink.MAV_CMD_DO_SET_MODE: self._set_mode,
            mavlink.MAV_CMD_MISSION_START: self._start_mission,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._reboot_command,
            mavlink.MAV_CMD_IMAGE_START_CAPTURE: self._no_camera,
            mavlink.MAV_CMD_DO_PAUSE_CONTINUE: self.auto.pause,
            mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: self.auto.set_current,
        }
        if self._config.autopilot == "ardupilot":
            actions[mavlink.MAV_CMD_CONDITION_YAW] = self._condition_yaw
        else:
            actions[mavlink.MAV_CMD_DO_REPOSITION] = self._reposition
        action = actions.get(command.id)
        return int(mavlink.MAV_RESULT_UNSUPPORTED) if action is None else action(command)

    def _arm(self, command: Command) -> int:
        return _ACCEPTED if self.airframe.arm(command.params[0] > 0.5) else _DENIED

    def _take_off(self, command: Command) -> int:
        # ArduPilot: metres above home; PX4: metres above sea level
        height = command.params[6]
        if self._config.autopilot == "px4":
            height -= self._config.airframe.home_altitude_m
        if math.isnan(height):
            height = self._config.airframe.height_m
        return _ACCEPTED if self.airframe.take_off(height) else _DENIED

    def _land(self, command: Command) -> int:
        del command
        self.modes.set(self.modes.land_mode)
        self.airframe.land()
        return _ACCEPTED

    def _do(self, item: Item) -> None:
        """Run an item of the mission that is no place to fly to, as the command that it is."""
        if self._trigger is not None and item.command in self._trigger.commands:
            params = (*item.params, float(item.x), float(item.y), item.z)
            self._trigger.command(Command(id=item.command, params=params, confirmation=0, sender=(0, 0)))

    def _start_mission(self, command: Command) -> int:
        """As ground stations begin a mission: from its current item on."""
        if command.params[:2] != (0.0, 0.0):
            return _DENIED
        if not self.auto.may_begin:
            return int(mavlink.MAV_RESULT_FAILED)
        self.modes.set("AUTO" if self._config.autopilot == "ardupilot" else "MISSION")
        return _ACCEPTED

    def _set_mode(self, command: Command) -> int:
        if self.modes.is_auto_command(command.params[1], command.params[2]) and not self.auto.may_begin:
            return int(mavlink.MAV_RESULT_FAILED)
        if not self.modes.set_from_command(command.params[1], command.params[2]):
            return _DENIED
        if self.modes.is_rtl:
            self.return_to_launch()
        if self.modes.is_landing:
            self.airframe.land()
        return _ACCEPTED

    def _condition_yaw(self, command: Command) -> int:
        """ArduCopter: accepted in every mode, executed only in autonomous modes."""
        heading_deg, rate_deg_s, direction, relative = command.params[:4]
        if not 0 <= heading_deg <= 360 or relative not in {0.0, 1.0}:
            return int(mavlink.MAV_RESULT_FAILED)
        if self.modes.is_guided:
            way = 1 if direction > 0 else -1 if direction < 0 else 0
            if relative:
                heading_deg = self.airframe.true_yaw_deg() + (heading_deg if way >= 0 else -heading_deg)
            else:
                heading_deg -= self._heading_error_deg()
            self.airframe.turn_to(heading_deg, rate_deg_s=rate_deg_s, direction=way)
        return _ACCEPTED

    def _reposition(self, command: Command) -> int:
        """PX4: only with the flag that changes to hold mode; of the position only the heading is used."""
        if int(command.params[1]) != 1:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        self.modes.set("LOITER")
        if math.isfinite(command.params[3]):
            self.airframe.turn_to(math.degrees(command.params[3]) - self._heading_error_deg())
        return _ACCEPTED

    def _capabilities(self, command: Command) -> int:
        del command
        return self._ground.request(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)

    def _no_camera(self, command: Command) -> int:
        del command
        ardupilot = self._config.autopilot == "ardupilot"
        return int(mavlink.MAV_RESULT_FAILED if ardupilot else mavlink.MAV_RESULT_UNSUPPORTED)

    def _reboot_command(self, command: Command) -> int:
        """Refused while armed; ArduPilot can be forced."""
        ardupilot = self._config.autopilot == "ardupilot"
        forced = ardupilot and int(command.params[5]) == _FORCED_REBOOT
        if self.airframe.armed and not forced:
            return int(mavlink.MAV_RESULT_FAILED) if ardupilot else _DENIED
        self._timeline.after(0.1, lambda: self.reboot(_REBOOT_S))
        return _ACCEPTED

    def say(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """STATUSTEXT (253) to the ground, at most 50 characters."""
        self._ground.send(mavlink.MAVLink_statustext_message(severity, text.encode()[:50]))


def _gimbal_wanted() -> Message:
    """PX4 asks everybody for GIMBAL_DEVICE_INFORMATION (283)."""
    wanted = mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_INFORMATION
    return mavlink.MAVLink_command_long_message(0, 0, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, wanted, 0, 0, 0, 0, 0, 0)
