"""The attitude reports of one gimbal: which of those that arrive count, in which frame, and when they were sent."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final

import structlog

from panoexec.adapters.gimbal.attitude_buffer import AttitudeBuffer
from panoexec.adapters.gimbal.attitude_messages import (
    gimbal_sample,
    number,
    told_heading_deg,
    vehicle_attitude,
    yaw_frame,
)
from panoexec.adapters.gimbal.dejitter import Backlog, StampCheck, StampDejitter
from panoexec.adapters.gimbal.gimbal_choice import FIRST_COMPONENT_ID, is_gimbal, source_for
from panoexec.adapters.gimbal.heading_filter import HeadingFilter
from panoexec.adapters.link.batching import MessageBatcher
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.devices import GimbalKnowledge, YawFrame

ATTITUDE_STATUS: Final = 285
ATTITUDE: Final = 30

_REPORT: Final = "GIMBAL_DEVICE_ATTITUDE_STATUS"
_SPARED_HZ: Final = 1.0
_DRIFT_HZ: Final = 5.0
_HEARD_S: Final = 10.0
"""Real seconds after which a component counts as silent; an idle link listens once a second."""
_RATED: Final = 40

_log = structlog.get_logger(__name__)


class GimbalReports:
    """Reads GIMBAL_DEVICE_ATTITUDE_STATUS (285) and ATTITUDE (30); for the event loop.

    Until `pin`, a gimbal's own reports are preferred to the autopilot's copy of them. From then on only those of the
    pinned component count, and its silence is silence: the reports of any other component are of another device.

    Attributes:
        buffer: the samples.
        frame: overrides the frame that the reports state; None: they are right.
        stated: the frame that the last report stated.
        device_id: gimbal device id of the gimbal in use; None as long as any is meant.
    """

    def __init__(self, link: MavsdkLink, *, known: GimbalKnowledge, frame: YawFrame | None, device: int) -> None:
        """Create it; nothing is received before `subscribe`.

        Args:
            link: to the autopilot.
            known: takes what the reports show.
            frame: see the attribute.
            device: the configured component or device id; 0: automatic.
        """
        self._link = link
        self._known = known
        self._device = device
        self._messages = MessageBatcher(self._take, post=link.post, eager=lambda: self.buffer.is_awaited)
        self.buffer = AttitudeBuffer(autopilot_component=AUTOPILOT, ingest=self._messages.ingest)
        self.frame = frame
        self.stated = YawFrame.VEHICLE
        self.device_id: int | None = None
        self._heading = HeadingFilter()
        self._stamps: dict[tuple[int, str], tuple[StampCheck, StampDejitter]] = {}
        self._backlogs: dict[int, Backlog] = {}
        self._heard: dict[int, float] = {}
        self._sample_s = -math.inf
        self._times: deque[float] = deque(maxlen=_RATED)
        self._source: tuple[int, YawFrame, YawFrame, bool] | None = None

    def subscribe(self) -> list[Callable[[], None]]:
        """Receive messages; returns functions that end that."""
        return [self._link.on(_REPORT, self._messages.put), self._link.on("ATTITUDE", self._messages.put)]

    @property
    def age_s(self) -> float:
        """Real seconds since the last report arrived, ingested or not; infinity before the first."""
        pending = (message.heard_s for message in reversed(self._messages.pending) if self._counts(message))
        return time.monotonic() - next(pending, self._sample_s)

    @property
    def has_any(self) -> bool:
        """Whether any report of a gimbal was ingested."""
        return bool(self._heard)

    @property
    def source_component(self) -> int | None:
        """The component whose reports count; None before the first."""
        return self.buffer.source_component

    def rate_hz(self) -> float:
        """Rate of the newest reports that count, on the mission's clock; 0 if there are too few, or none of late."""
        self.buffer.ingest()
        times = self._times
        if len(times) < 4 or self._link.clock.monotonic() - times[-1] > 1.0:
            return 0.0
        recent = [at for at in times if at >= times[-1] - 1.0]
        return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 and recent[-1] > recent[0] else 0.0

    def heard(self) -> list[int]:
        """Components that told an attitude of the gimbal in use of late."""
        self.buffer.ingest()
        now = time.monotonic()
        return sorted(component for component, at in self._heard.items() if now - at <= _HEARD_S)

    def pin(self, device_id: int) -> int:
        """Let only the reports of that gimbal's component count, for good; returns the component.

        Raises:
            DeviceError: no component tells its attitude.
        """
        self.device_id = device_id
        if self.buffer.pinned is None:
            self.buffer.pin(source_for(device_id, self.heard(), device=self._device))
            _log.info("the gimbal's attitude", component=self.buffer.pinned, device_id=device_id)
        assert self.buffer.pinned is not None
        self._known.device, self._known.device_id = self.buffer.pinned, device_id
        return self.buffer.pinned

    def rebooted(self) -> None:
        """The autopilot rebooted: its time stamps begin anew."""
        self.buffer.rebooted()
        for key in [key for key in self._stamps if key[0] == AUTOPILOT]:
            del self._stamps[key]

    def _take(self, message: MavMessage) -> None:
        try:
            if message.name == "ATTITUDE":
                self._airframe(message)
            else:
                self._attitude(message)
        except (LookupError, TypeError, ValueError) as error:
            message.unusable(error)

    def _attitude(self, message: MavMessage) -> None:
        fields, component = message.fields, message.component_id
        if not self._is_own_device(fields, component):
            return
        if not self._may_tell(component):
            self._ignore(component)
            return
        if not self._counts(message):
            self._heard[component] = message.heard_s
            if component != AUTOPILOT:
                self._ignore(component)
            return
        sent_s = self._sent_s(message)
        if sent_s is None:
            return
        self._heard[component] = message.heard_s
        told_deg = told_heading_deg(fields) if component != AUTOPILOT else math.nan
        stated = yaw_frame(int(fields["flags"]))
        takes = self.buffer.takes(component, sent_s)
        heading_deg = self._heading.gimbal(told_deg, sent_s) if takes else math.nan
        sample = gimbal_sample(
            fields,
            sent_s,
            self.frame,
            heading_deg=heading_deg,
            north_off_deg=told_deg - heading_deg if self.frame is None else math.nan,
        )
        self._sample_s = message.heard_s
        if not self.buffer.put_sample(sample, component):
            return
        self.stated = stated
        self._times.append(sent_s)
        self._known.north_off_deg = self._heading.difference_deg
        self._known.north_corrected = math.isfinite(heading_deg)
        source = component, stated, sample.yaw_frame, math.isfinite(told_deg) and told_deg != 0
        if source != self._source:
            self._source = source
            self._source_changed(*source)

    def _is_own_device(self, fields: Mapping[str, Any], component: int) -> bool:
        """Whether a report is not of a second mount of the vehicle."""
        named = int(fields.get("gimbal_device_id") or 0)
        return self.device_id is None or named in (0, self.device_id, component)

    def _may_tell(self, component: int) -> bool:
        if component == self.buffer.pinned or (self._device >= FIRST_COMPONENT_ID and component == self._device):
            return True
        types = {number: kind for number, (kind, _) in self._link.components.items()}
        return is_gimbal(component, types)

    def _ignore(self, component: int) -> None:
        """Tell once of a component whose attitudes do not count."""
        if component not in self._known.strangers:
            self._known.strangers.add(component)
            _log.warning("attitudes of another component are ignored", component=component, gimbal=self.buffer.pinned)

    def _counts(self, message: MavMessage) -> bool:
        """Whether a message is a report of the gimbal in use."""
        try:
            own = message.name == _REPORT and self._is_own_device(message.fields, message.component_id)
        except (TypeError, ValueError):
            return False
        return own and self.buffer.pinned in (None, message.component_id)

    def _airframe(self, message: MavMessage) -> None:
        if message.component_id != AUTOPILOT:
            return
        sent_s = self._sent_s(message)
        if sent_s is not None:
            self.buffer.put_vehicle(vehicle_attitude(message.fields, sent_s))
            self._heading.vehicle(math.degrees(number(message.fields["yaw"])), sent_s)

    def _sent_s(self, message: MavMessage) -> float | None:
        """When a message was sent, without jitter; None if its stamp does not fit those before it.

        Each component and message name is a stream of its own.
        """
        key = message.component_id, message.name
        check, dejitter = self._stamps.setdefault(key, (StampCheck(), StampDejitter()))
        stamp_s = number(message.fields["time_boot_ms"]) / 1000.0
        if not check.fits(stamp_s, message.received_s):
            return None
        if message.name == _REPORT:
            backlog = self._backlogs.setdefault(message.component_id, Backlog())
            backlog.note(stamp_s, message.received_s)
            self.buffer.late_s = backlog.late_s
        return dejitter.sent_s(stamp_s, message.received_s)

    def _source_changed(self, component: int, stated: YawFrame, used: YawFrame, tells_heading: bool) -> None:
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
            compared = stated is not YawFrame.EARTH or tells_heading
            throttled[ATTITUDE] = _DRIFT_HZ if compared else _SPARED_HZ
