"""A gimbal behind a MAVLink gimbal manager (protocol v2): discover, acquire, point, receive attitudes, release."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Any, Final, Literal, Self, TypeAlias

import structlog
from mavsdk.plugins.gimbal import ControlMode, ControlStatus, Gimbal, GimbalItem, GimbalList, GimbalMode, SendMode

from panoexec.adapters.gimbal.attitude_buffer import AttitudeBuffer
from panoexec.adapters.gimbal.attitude_messages import (
    gimbal_sample,
    manager_limits,
    number,
    told_heading_deg,
    vehicle_attitude,
    yaw_frame,
)
from panoexec.adapters.gimbal.dejitter import StampDejitter
from panoexec.adapters.gimbal.heading_filter import HeadingFilter
from panoexec.adapters.link.batching import MessageBatcher
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.devices import AttitudeFeed, YawFrame
from panoexec.errors import DeviceError
from panoexec.planning.model import GimbalLimits

Feedback: TypeAlias = Literal["earth", "vehicle", "body", "none"]
"""Kind of the attitude reports: measured in the earth or the vehicle frame, commanded servo angles (`body`), or an
echo of the setpoint (`none`)."""

ATTITUDE_STATUS: Final = 285
ATTITUDE: Final = 30
MANAGER_STATUS: Final = 281
MANAGER_INFORMATION: Final = 280

_MAV_TYPE_GIMBAL: Final = 26
_TAKE_S: Final = 3.0
_RELEASE_S: Final = 2.5
_SPARED_HZ: Final = 1.0
_DRIFT_HZ: Final = 5.0
_SERVO: Final = 1
_BRUSHLESS_PWM: Final = 7
_FRAMES: Final[dict[Feedback, YawFrame]] = {
    "earth": YawFrame.EARTH,
    "vehicle": YawFrame.VEHICLE,
    "body": YawFrame.BODY,
}

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class GimbalFound:
    """The result of discovery.

    Attributes:
        gimbal_id: its id in MAVSDK.
        manager_component: MAVLink component of its manager.
        device_id: its gimbal device id.
        vendor, model: as reported, or "".
        feedback: the kind of its attitude reports.
    """

    gimbal_id: int
    manager_component: int
    device_id: int
    vendor: str
    model: str
    feedback: Feedback


class MavsdkGimbal:
    """Implements `Gimbal`; an async context manager on an open link, valid across reboots of the autopilot.

    The attitude is read from MAVLink messages, not from MAVSDK's gimbal plugin, which drops the frame and failure
    flags, pairs yaw with the last received ATTITUDE, and receives only one of two sources.
    """

    def __init__(self, link: MavsdkLink, *, feedback: Feedback | None = None) -> None:
        """Create it; entering the context subscribes to messages.

        Args:
            link: to the autopilot, entered before and left after this.
            feedback: overrides the reported kind; None: use the frame flags, or the mount type if the autopilot has
                that parameter.
        """
        self._link = link
        self._feedback_wanted = feedback
        self._frame = _FRAMES.get(feedback) if feedback else None
        self._reports = MessageBatcher(self._report, post=link.post, eager=lambda: self._buffer.is_awaited)
        self._buffer = AttitudeBuffer(autopilot_component=AUTOPILOT, ingest=self._reports.ingest)
        self._heading = HeadingFilter()
        self._stamps: dict[tuple[int, str], StampDejitter] = {}
        self._stated = YawFrame.VEHICLE
        self._found: GimbalFound | None = None
        self._limits: GimbalLimits | None = None
        self._control: ControlStatus | None = None
        self._status_came = asyncio.Event()
        self._listed = asyncio.Event()
        self._list: list[GimbalItem] = []
        self._sample_s = -math.inf
        self._source: tuple[int, YawFrame, YawFrame] | None = None
        self._off: list[Callable[[], None]] = []

    # --- state

    @property
    def feed(self) -> AttitudeFeed:
        """See `Gimbal.feed`."""
        return self._buffer

    @property
    def limits(self) -> GimbalLimits | None:
        """See `Gimbal.limits`. The yaw range is relative to the vehicle's heading."""
        return self._limits

    @property
    def in_control(self) -> bool:
        """See `Gimbal.in_control`."""
        status = self._control
        return status is not None and self._holder(status) == self._link.own_ids

    @property
    def controlled_by(self) -> tuple[int, int] | None:
        """MAVLink system and component in primary control, (0, 0) for none; None before the first status."""
        return None if self._control is None else self._holder(self._control)

    @property
    def found(self) -> GimbalFound | None:
        """The result of discovery; None before."""
        return self._found

    @property
    def age_s(self) -> float:
        """Real seconds since the last attitude report arrived, ingested or not; infinity before the first."""
        pending = (message.heard_s for message in reversed(self._reports.pending) if self._is_own_report(message))
        return time.monotonic() - next(pending, self._sample_s)

    # --- life cycle

    async def __aenter__(self) -> Self:
        """Subscribe to messages."""
        self._off = [
            self._link.on("GIMBAL_DEVICE_ATTITUDE_STATUS", self._reports.put),
            self._link.on("ATTITUDE", self._reports.put),
            self._link.on("GIMBAL_MANAGER_INFORMATION", self._information),
        ]
        self._off.append(self._link.when_attached(self._attach))
        self._off.append(self._link.when_back(self._came_back))
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Unsubscribe; does not release the gimbal."""
        for off in self._off:
            off()

    async def discover(self, timeout_s: float = 15.0) -> GimbalFound:
        """Return when the gimbal was found, its limits were requested and its kind of feedback is known.

        MAVSDK lists a gimbal that ArduPilot drives itself about 5 s after its first attitude report.

        Args:
            timeout_s: real seconds.

        Raises:
            DeviceError: no gimbal; the message says what is missing.
            LinkError: no autopilot.
        """
        if self._found is not None:
            return self._found
        plugin = self._link.requests.plugin(Gimbal)
        try:
            async with asyncio.timeout(timeout_s):
                await self._listed.wait()
                # the kind of feedback depends on the sender; the list may arrive before the first report
                await self._buffer.newer_than(-math.inf)
        except TimeoutError as error:
            raise DeviceError(f"no gimbal within {timeout_s:g} s: {self._why_not_found()}") from error
        item = self._list[0]
        await self._ask_limits(item.gimbal_manager_component_id)
        self._found = GimbalFound(
            gimbal_id=item.gimbal_id,
            manager_component=item.gimbal_manager_component_id,
            device_id=item.gimbal_device_id,
            vendor=item.vendor_name,
            model=item.model_name,
            feedback=await self._find_feedback(item.gimbal_device_id),
        )
        _log.info("gimbal found", gimbal=self._found, limits=self._limits, plugin=type(plugin).__name__)
        return self._found

    async def acquire(self) -> None:
        """See `Gimbal.acquire`. Also requests the attitude at full rate."""
        gimbal = await self.discover()
        await self._link.use_rates(active=True)
        plugin = self._link.requests.plugin(Gimbal)
        take = partial(plugin.take_control, gimbal.gimbal_id, ControlMode.PRIMARY)
        self._control = None
        await self._link.requests.mavsdk_call("taking control of the gimbal", take)
        try:
            async with asyncio.timeout(_TAKE_S):
                await self._ask_status(gimbal.manager_component)
                while not self.in_control:
                    self._status_came.clear()
                    await self._status_came.wait()
        except TimeoutError as error:
            holder = "no primary control"
            if self._control is not None:
                holder = "system {} component {}".format(*self._holder(self._control))
            raise DeviceError(
                f"taking control of the gimbal: accepted, but its manager reports {holder} after {_TAKE_S:g} s"
            ) from error

    async def point(self, pitch_deg: float, yaw_deg: float | None) -> None:
        """See `Gimbal.point`."""
        if not (math.isfinite(pitch_deg) and (yaw_deg is None or math.isfinite(yaw_deg))):
            raise ValueError(f"cannot point at pitch {pitch_deg}, yaw {yaw_deg}")
        gimbal = await self.discover()
        set_angles = partial(
            self._link.requests.plugin(Gimbal).set_angles,
            gimbal.gimbal_id,
            0.0,
            pitch_deg,
            0.0 if yaw_deg is None else (yaw_deg + 180.0) % 360.0 - 180.0,
            GimbalMode.YAW_FOLLOW if yaw_deg is None else GimbalMode.YAW_LOCK,
            SendMode.ONCE,
        )
        where = "along the heading" if yaw_deg is None else f"yaw {yaw_deg:.1f}°"
        await self._link.requests.mavsdk_call(f"pointing the gimbal at pitch {pitch_deg:.1f}° {where}", set_angles)

    async def release(self) -> None:
        """See `Gimbal.release`. Also requests the attitude at the idle rate."""
        with contextlib.suppress(DeviceError, TimeoutError):
            async with asyncio.timeout(_RELEASE_S):
                if self._found is not None:
                    plugin = self._link.requests.plugin(Gimbal)
                    give = partial(plugin.release_control, self._found.gimbal_id)
                    await self._link.requests.mavsdk_call("releasing the gimbal", give)
                    self._control = None
                await self._link.use_rates(active=False)
                return
        self._link.streams.active = False
        _log.warning("gimbal release was not acknowledged")

    # --- reports, on the loop

    def _report(self, message: MavMessage) -> None:
        try:
            if message.name == "ATTITUDE":
                self._airframe(message)
            else:
                self._attitude(message)
        except (LookupError, TypeError, ValueError) as error:
            message.unusable(error)

    def _attitude(self, message: MavMessage) -> None:
        fields = message.fields
        if not self._is_own_device(fields):
            return
        self._sample_s = message.heard_s
        sent_s = self._sent_s(message)
        heading_deg = math.nan
        if message.component_id != AUTOPILOT:
            heading_deg = self._heading.gimbal(told_heading_deg(fields), sent_s)
        self._stated = yaw_frame(int(fields["flags"]))
        sample = gimbal_sample(fields, sent_s, self._frame, heading_deg=heading_deg)
        taken = self._buffer.put_sample(sample, message.component_id)
        source = message.component_id, self._stated, sample.yaw_frame
        if taken and source != self._source:
            self._source = source
            self._source_changed(*source)

    def _is_own_device(self, fields: Mapping[str, Any]) -> bool:
        """Whether a report is not of a second mount of the vehicle."""
        return self._found is None or int(fields.get("gimbal_device_id") or 0) in (0, self._found.device_id)

    def _is_own_report(self, message: MavMessage) -> bool:
        try:
            return message.name == "GIMBAL_DEVICE_ATTITUDE_STATUS" and self._is_own_device(message.fields)
        except (TypeError, ValueError):
            return False

    def _airframe(self, message: MavMessage) -> None:
        if message.component_id == AUTOPILOT:
            sent_s = self._sent_s(message)
            self._buffer.put_vehicle(vehicle_attitude(message.fields, sent_s))
            self._heading.vehicle(math.degrees(number(message.fields["yaw"])), sent_s)

    def _sent_s(self, message: MavMessage) -> float:
        """When a message was sent, without jitter; each component and message name is a stream of its own."""
        stamps = self._stamps.setdefault((message.component_id, message.name), StampDejitter())
        return stamps.sent_s(number(message.fields["time_boot_ms"]) / 1000.0, message.received_s)

    # --- in MAVSDK's thread

    def _information(self, message: MavMessage) -> None:
        limits = manager_limits(message.fields)
        if limits is not None:
            self._limits = limits

    def _gimbals_listed(self, gimbals: GimbalList, _user_data: object) -> None:
        if gimbals.gimbals:
            self._list = list(gimbals.gimbals)
            self._link.post(self._listed.set)

    def _control_status(self, status: ControlStatus, _user_data: object) -> None:
        if self._found is not None and status.gimbal_id != self._found.gimbal_id:
            return
        self._control = status
        self._link.post(self._status_came.set)

    # --- on the loop

    def _attach(self) -> None:
        plugin = self._link.requests.plugin(Gimbal)
        gimbal_list = plugin.subscribe_gimbal_list(self._gimbals_listed)
        control_status = plugin.subscribe_control_status(self._control_status)
        self._off.append(partial(plugin.unsubscribe_gimbal_list, gimbal_list))
        self._off.append(partial(plugin.unsubscribe_control_status, control_status))

    def _came_back(self) -> None:
        self._buffer.rebooted()
        self._control = None

    def _source_changed(self, component: int, stated: YawFrame, used: YawFrame) -> None:
        """Throttle streams that are not needed: each message that reaches Python costs CPU time.

        The autopilot's copy of the reports is throttled while the gimbal's own arrive. The vehicle's attitude is needed
        at the same rate to compose body and vehicle frames; at a lower rate if it only corrects the heading that the
        gimbal reports; hardly at all for reports in the earth frame.
        """
        throttled = self._link.streams.throttled
        throttled.pop(ATTITUDE_STATUS, None)
        throttled.pop(ATTITUDE, None)
        if component != AUTOPILOT:
            throttled[ATTITUDE_STATUS] = _SPARED_HZ
        if used is YawFrame.EARTH:
            throttled[ATTITUDE] = _SPARED_HZ if stated is YawFrame.EARTH else _DRIFT_HZ

    async def _ask_limits(self, manager: int) -> None:
        if self._limits is not None:
            return
        with contextlib.suppress(DeviceError):  # then no limits are known
            self._information(
                await self._link.requests.message(MANAGER_INFORMATION, "GIMBAL_MANAGER_INFORMATION", component=manager)
            )

    async def _ask_status(self, manager: int) -> None:
        with contextlib.suppress(DeviceError):  # it streams too
            await self._link.requests.message(MANAGER_STATUS, "GIMBAL_MANAGER_STATUS", component=manager)

    async def _find_feedback(self, device_id: int) -> Feedback:
        """The mount's kind of feedback; ArduPilot sets the vehicle frame even without feedback (see docs)."""
        if self._feedback_wanted is not None:
            return self._feedback_wanted
        stated: Feedback = "earth" if self._stated is YawFrame.EARTH else "vehicle"
        if not self._link.is_ardupilot or self._buffer.source_component != AUTOPILOT:
            return stated
        kind = await self._link.requests.parameter(f"MNT{max(device_id, 1)}_TYPE")
        if kind == _SERVO:
            self._frame = YawFrame.BODY
            return "body"
        return "none" if kind == _BRUSHLESS_PWM else stated

    def _why_not_found(self) -> str:
        if not self._link.connected:
            return "no heartbeat from the autopilot"
        if foreign := self._link.identity.foreign(_MAV_TYPE_GIMBAL, "gimbal"):
            return foreign
        if self._sample_s == -math.inf:
            return (
                "GIMBAL_DEVICE_ATTITUDE_STATUS (285) is not received; ArduPilot: set MNT1_TYPE and reboot; "
                "PX4: set MNT_MODE_OUT and MNT_MODE_IN to MAVLink gimbal protocol v2"
            )
        return "its attitude arrives, but no gimbal manager answers the request for GIMBAL_MANAGER_INFORMATION (280)"

    @staticmethod
    def _holder(status: ControlStatus) -> tuple[int, int]:
        return status.sysid_primary_control, status.compid_primary_control
