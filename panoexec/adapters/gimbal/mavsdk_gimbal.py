"""A gimbal behind a MAVLink gimbal manager (protocol v2): discover, acquire, point, receive attitudes, release."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Final, Self

import structlog
from mavsdk.plugins.gimbal import ControlStatus, Gimbal, GimbalItem, GimbalList

from panoexec.adapters.gimbal.attitude_messages import manager_limits
from panoexec.adapters.gimbal.device_rate import DeviceRate
from panoexec.adapters.gimbal.feedback_kind import FRAMES, Feedback, echo_by_parameters
from panoexec.adapters.gimbal.gimbal_choice import Candidate, in_order, with_unlisted
from panoexec.adapters.gimbal.gimbal_reports import GimbalReports
from panoexec.adapters.gimbal.manager_commands import ManagerCommands
from panoexec.adapters.gimbal.north_trim import NorthTrim
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.devices import AttitudeFeed, GimbalKnowledge, YawFrame
from panoexec.errors import DeviceError, LinkError
from panoexec.planning.model import GimbalLimits

MANAGER_STATUS: Final = 281
MANAGER_INFORMATION: Final = 280

_MAV_TYPE_GIMBAL: Final = 26
_TAKE_S: Final = 3.0
_ASK_AGAIN_S: Final = 0.5
_RELEASE_S: Final = 2.5

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

    def __init__(
        self, link: MavsdkLink, *, feedback: Feedback | None = None, manager: int = 0, device: int = 0
    ) -> None:
        """Create it; entering the context subscribes to messages.

        Args:
            link: to the autopilot, entered before and left after this.
            feedback: overrides the reported kind; None: use the frame flags, or the mount type if the autopilot has
                that parameter.
            manager: MAVLink component of the only manager to use; 0: the autopilot's, then the others.
            device: the only gimbal to use, by the component that tells its attitude or by its device id; 0: automatic.
        """
        self._link = link
        self._feedback_wanted = feedback
        self._manager = manager
        self._device = device
        self._known = GimbalKnowledge()
        self._reports = GimbalReports(
            link, known=self._known, frame=FRAMES.get(feedback) if feedback else None, device=device
        )
        self._rate = DeviceRate(link, self._reports)
        self._north = NorthTrim(self._known)
        self._commands = ManagerCommands(link)
        self._found: GimbalFound | None = None
        self._limits: dict[tuple[int, int], GimbalLimits | None] = {}
        self._control: dict[int, tuple[int, int]] = {}
        self._status_came = asyncio.Event()
        self._listed = asyncio.Event()
        self._list: list[GimbalItem] = []
        self._off: list[Callable[[], None]] = []

    # --- state

    @property
    def feed(self) -> AttitudeFeed:
        """See `Gimbal.feed`."""
        return self._reports.buffer

    @property
    def reports(self) -> GimbalReports:
        """Its attitude reports, and who sends them."""
        return self._reports

    @property
    def known(self) -> GimbalKnowledge:
        """See `Gimbal.known`."""
        return self._known

    @property
    def limits(self) -> GimbalLimits | None:
        """See `Gimbal.limits`. The yaw range is relative to the vehicle's heading."""
        if self._found is None:
            return next((limits for (manager, _), limits in self._limits.items() if manager == AUTOPILOT), None)
        return self.limits_of(self._found.manager_component, self._found.device_id)

    def limits_of(self, manager: int, device_id: int) -> GimbalLimits | None:
        """The limits that a manager reports for a device; None if unknown."""
        return self._limits.get((manager, device_id))

    @property
    def in_control(self) -> bool:
        """See `Gimbal.in_control`."""
        return self.controlled_by == self._link.own_ids

    @property
    def controlled_by(self) -> tuple[int, int] | None:
        """MAVLink system and component in primary control, (0, 0) for none.

        None before the first status, and after a reboot or a link gap until the next one.
        """
        return None if self._found is None else self._control.get(self._found.gimbal_id)

    @property
    def found(self) -> GimbalFound | None:
        """The result of discovery; None before."""
        return self._found

    @property
    def candidates(self) -> list[Candidate]:
        """All gimbals that managers offer, also those that the configuration excludes."""
        listed = [
            Candidate(
                gimbal_id=item.gimbal_id,
                manager=item.gimbal_manager_component_id,
                device_id=item.gimbal_device_id,
                vendor=item.vendor_name,
                model=item.model_name,
            )
            for item in self._list
        ]
        return in_order(with_unlisted(listed, self._limits))

    @property
    def age_s(self) -> float:
        """Real seconds since the last attitude report arrived, ingested or not; infinity before the first."""
        return self._reports.age_s

    # --- life cycle

    async def __aenter__(self) -> Self:
        """Subscribe to messages."""
        self._off = [
            *self._reports.subscribe(),
            self._link.on("GIMBAL_MANAGER_INFORMATION", self._information),
            self._link.on("GIMBAL_MANAGER_STATUS", self._manager_status),
        ]
        self._off.append(self._link.when_attached(self._attach))
        self._off.append(self._link.when_back(self._came_back))
        return self

    async def __aexit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Unsubscribe; does not release the gimbal."""
        await self._rate.stop()
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
        try:
            async with asyncio.timeout(timeout_s):
                await self._first_listed()
                # the kind of feedback depends on the sender; the list may arrive before the first report
                await self._reports.buffer.newer_than(-math.inf)
        except TimeoutError as error:
            raise DeviceError(f"no gimbal within {timeout_s:g} s: {self._why_not_found()}") from error
        found = await self._use(self._usable()[0])
        others = [one.describe() for one in self.candidates if one.gimbal_id != found.gimbal_id]
        _log.info("gimbal found", gimbal=found, limits=self.limits, others=others)
        return found

    async def acquire(self) -> None:
        """See `Gimbal.acquire`. Also requests the attitude at full rate.

        If the manager refuses, the next one is asked, until one was in control once: from then on manager and device
        stay the same.
        """
        found = await self.discover()
        await self._link.use_rates(active=True)
        choices = self._usable()
        if self._reports.buffer.pinned is not None:
            choices = [one for one in choices if one.gimbal_id == found.gimbal_id]
        choices.sort(key=lambda one: one.gimbal_id != found.gimbal_id)
        refused: DeviceError | None = None
        for choice in choices:
            try:
                await self._request_control(choice)
            except LinkError:
                raise
            except DeviceError as error:
                _log.warning("gimbal manager refuses control", gimbal=choice.describe(), error=str(error))
                refused = refused or error
                continue
            if choice.gimbal_id != found.gimbal_id:
                found = await self._use(choice)
            await self._confirm_control(found)
            before = self._reports.source_component
            if self._reports.pin(found.device_id) != before:
                await self._use(choice)  # its reports come from another component: what they are worth may differ
            self._rate.begin()
            return
        raise refused or DeviceError("no gimbal is left to be taken")

    async def _request_control(self, choice: Candidate) -> None:
        self._control.pop(choice.gimbal_id, None)
        await self._commands.take(choice.gimbal_id, manager=choice.manager, device_id=choice.device_id)

    async def _confirm_control(self, gimbal: GimbalFound) -> None:
        """Return when the manager's status names us.

        Raises:
            DeviceError: it does not.
        """
        try:
            async with asyncio.timeout(_TAKE_S):
                while True:
                    # asked again and again: a status may be lost, and not every manager sends it by itself
                    self._status_came.clear()
                    await self._ask_status(gimbal.manager_component, timeout_s=_ASK_AGAIN_S)
                    if self.in_control:
                        return
                    with contextlib.suppress(TimeoutError):
                        async with asyncio.timeout(_ASK_AGAIN_S):
                            await self._status_came.wait()
        except TimeoutError as error:
            if self.in_control:  # the answer to our question was lost, not the confirmation
                return
            holder = self.controlled_by
            named = "no primary control" if holder is None else "system {} component {}".format(*holder)
            raise DeviceError(
                f"taking control of the gimbal: accepted, but its manager reports {named} after {_TAKE_S:g} s"
            ) from error

    async def ask_rate(self) -> None:
        """Ask the gimbal itself for its attitude at full rate if it is sent at a lower one; needs a pinned source."""
        await self._rate.ask()

    async def ask_control(self) -> None:
        """See `AnswersControl.ask_control`."""
        if self._found is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_TAKE_S):
                    await self._ask_status(self._found.manager_component)

    async def point(self, pitch_deg: float, yaw_deg: float | None) -> None:
        """See `Gimbal.point`."""
        if not (math.isfinite(pitch_deg) and (yaw_deg is None or math.isfinite(yaw_deg))):
            raise ValueError(f"cannot point at pitch {pitch_deg}, yaw {yaw_deg}")
        gimbal = await self.discover()
        send_deg = 0.0
        if yaw_deg is not None:
            self.feed.ingest()
            now_s = self._link.clock.monotonic()
            send_deg = self._north.command(pitch_deg, yaw_deg, newest=self.feed.latest, now_s=now_s)
        await self._commands.point(
            gimbal.gimbal_id,
            manager=gimbal.manager_component,
            device_id=gimbal.device_id,
            pitch_deg=pitch_deg,
            yaw_deg=None if yaw_deg is None else (send_deg + 180.0) % 360.0 - 180.0,
        )

    async def release(self) -> None:
        """See `Gimbal.release`. Also requests the attitude at the idle rate."""
        with contextlib.suppress(DeviceError, TimeoutError):
            async with asyncio.timeout(_RELEASE_S):
                if (found := self._found) is not None:
                    await self._commands.release(
                        found.gimbal_id, manager=found.manager_component, device_id=found.device_id
                    )
                    self._control.pop(found.gimbal_id, None)
                await self._rate.restore()
                await self._link.use_rates(active=False)
                return
        self._link.streams.active = False
        _log.warning("gimbal release was not acknowledged")

    # --- in MAVSDK's thread

    def _information(self, message: MavMessage) -> None:
        device_id = int(message.fields.get("gimbal_device_id") or 0)
        self._limits[message.component_id, device_id] = manager_limits(message.fields)

    def _gimbals_listed(self, gimbals: GimbalList, _user_data: object) -> None:
        if gimbals.gimbals:
            self._list = list(gimbals.gimbals)
            self._link.post(self._listed.set)

    def _control_status(self, status: ControlStatus, _user_data: object) -> None:
        self._take_control_status(status.gimbal_id, (status.sysid_primary_control, status.compid_primary_control))

    def _manager_status(self, message: MavMessage) -> None:
        """GIMBAL_MANAGER_STATUS (281), each one: MAVSDK does not report a status again that did not change."""
        found, fields = self._found, message.fields
        device = int(fields["gimbal_device_id"])
        if found is None or message.component_id != found.manager_component or device not in (0, found.device_id):
            return
        holder = int(fields["primary_control_sysid"]), int(fields["primary_control_compid"])
        self._take_control_status(found.gimbal_id, holder)

    def _take_control_status(self, gimbal_id: int, holder: tuple[int, int]) -> None:
        self._control[gimbal_id] = holder
        self._link.post(self._status_came.set)

    # --- on the loop

    def _attach(self) -> None:
        plugin = self._link.requests.plugin(Gimbal)
        gimbal_list = plugin.subscribe_gimbal_list(self._gimbals_listed)
        control_status = plugin.subscribe_control_status(self._control_status)
        self._off.append(partial(plugin.unsubscribe_gimbal_list, gimbal_list))
        self._off.append(partial(plugin.unsubscribe_control_status, control_status))

    def _came_back(self) -> None:
        self._reports.rebooted()
        self._control.clear()

    def _usable(self) -> list[Candidate]:
        return in_order(self.candidates, manager=self._manager, device=self._device)

    async def _first_listed(self) -> None:
        """Return when a gimbal that may be used is listed; waits for the autopilot's if it is a manager.

        The order in which managers are found is by chance.
        """
        await self._listed.wait()
        has_own = self._manager not in (0, AUTOPILOT) or self._has(AUTOPILOT)
        if not has_own:
            has_own = not await self._ask_limits(AUTOPILOT)
        # a manager of the autopilot that MAVSDK never lists (`with_unlisted`) is there as soon as it has answered
        while not self._usable() or not (has_own or self._has(AUTOPILOT)):
            self._listed.clear()
            await self._listed.wait()

    def _has(self, manager: int) -> bool:
        return any(one.manager == manager for one in self._usable())

    async def _use(self, choice: Candidate) -> GimbalFound:
        """Use that gimbal from now on."""
        if self.limits_of(choice.manager, choice.device_id) is None:
            await self._ask_limits(choice.manager)
        if self._reports.buffer.pinned is None:
            self._reports.device_id = choice.device_id
        self._known.manager, self._known.device_id = choice.manager, choice.device_id
        self._found = GimbalFound(
            gimbal_id=choice.gimbal_id,
            manager_component=choice.manager,
            device_id=choice.device_id,
            vendor=choice.vendor,
            model=choice.model,
            feedback=await self._find_feedback(choice.device_id),
        )
        self._known.feedback = self._found.feedback
        return self._found

    async def _ask_limits(self, manager: int) -> bool:
        """Ask a manager for its limits; returns whether it is one."""
        try:
            self._information(
                await self._link.requests.message(MANAGER_INFORMATION, "GIMBAL_MANAGER_INFORMATION", component=manager)
            )
        except DeviceError:  # then no limits are known
            return False
        return True

    async def _ask_status(self, manager: int, *, timeout_s: float = 2.0) -> None:
        with contextlib.suppress(DeviceError):  # it streams too
            await self._link.requests.message(
                MANAGER_STATUS, "GIMBAL_MANAGER_STATUS", component=manager, timeout_s=timeout_s
            )

    async def _find_feedback(self, device_id: int) -> Feedback:
        """The kind of the reports; what the autopilot itself reports may be what it demands."""
        frame: YawFrame | None = None
        if self._reports.source_component == AUTOPILOT:
            self._known.echo, frame = await echo_by_parameters(
                self._link.requests.parameter, ardupilot=self._link.is_ardupilot, device_id=device_id
            )
        if self._feedback_wanted is not None:
            return self._feedback_wanted
        self._reports.frame = frame
        if self._known.echo:
            _log.warning("the gimbal's reports are no feedback", reason=self._known.echo)
            return "none"
        return "earth" if self._reports.stated is YawFrame.EARTH else "vehicle"

    def _why_not_found(self) -> str:
        if not self._link.connected:
            return "no heartbeat from the autopilot"
        if foreign := self._link.identity.foreign(_MAV_TYPE_GIMBAL, "gimbal"):
            return foreign
        if not self._reports.has_any:
            return (
                "GIMBAL_DEVICE_ATTITUDE_STATUS (285) is not received; ArduPilot: set MNT1_TYPE and reboot; "
                "PX4: set MNT_MODE_OUT and MNT_MODE_IN to MAVLink gimbal protocol v2"
            )
        if self.candidates and not self._usable():
            return (
                f"[gimbal] manager = {self._manager}, device = {self._device} is none of"
                f" {'; '.join(one.describe() for one in self.candidates)}"
            )
        return "its attitude arrives, but no gimbal manager answers the request for GIMBAL_MANAGER_INFORMATION (280)"
