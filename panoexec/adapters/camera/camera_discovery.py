"""Finds the cameras behind a MAVLink connection and chooses one (`camera_choice`)."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from functools import partial
from typing import Final

import structlog
from mavsdk.plugins.camera import Camera, CameraList, Information

from panoexec.adapters.camera.camera_choice import LAST_OF_AUTOPILOT, CameraCandidate, Choice, choose, why_none
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.mavsdk_requests import REQUEST_MESSAGE
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.adapters.link.stream_keeper import AUTOPILOT
from panoexec.errors import DeviceError

CAMERA_INFORMATION: Final = 259
MAV_TYPE_CAMERA: Final = 30
_PREFER_S: Final = 2.5
"""How long others that beat as cameras are waited for before one is chosen."""
_ASK_AGAIN_S: Final = 1.0
_LOOK_S: Final = 0.25
_TRIGGER_MODES: Final = (1, 4)
"""TRIG_MODE in which PX4 triggers on command alone."""
_BY_ITSELF: Final = (2, 3)

_log = structlog.get_logger(__name__)


class CameraDiscovery:
    """All cameras that told what they are; MAVSDK asks every component that beats, but keeps their flags to itself."""

    def __init__(self, link: MavsdkLink, *, component: int, image_px: tuple[int, int] | None) -> None:
        """Create it.

        Args:
            link: to the autopilot.
            component: `[camera] component`, 0 for any.
            image_px: image size of the profile; see `choose`.
        """
        self._link = link
        self._component = component
        self._image_px = image_px
        self._listed: dict[int, Information] = {}
        self._flags: dict[int, int] = {}
        self._asked_s = 0.0
        self._changed = asyncio.Event()
        self._trigger_mode: int | None = None
        """TRIG_MODE; None where it could not be read."""

    @property
    def candidates(self) -> list[CameraCandidate]:
        """The cameras that told what they can do, by component."""
        return [
            CameraCandidate(
                component=component,
                vendor=one.vendor_name,
                model=one.model_name,
                image_width_px=one.horizontal_resolution_px,
                image_height_px=one.vertical_resolution_px,
                focal_length_mm=one.focal_length_mm,
                flags=self._flags[component],
            )
            for component, one in sorted(self._listed.items())
            if component in self._flags
        ]

    @property
    def beating(self) -> list[int]:
        """Components that beat as cameras."""
        return sorted(component for component, (kind, _) in self._link.components.items() if kind == MAV_TYPE_CAMERA)

    def subscribe(self) -> list[Callable[[], None]]:
        """Begin to listen; returns what ends it."""
        off: list[Callable[[], None]] = [self._link.on("CAMERA_INFORMATION", self._informed)]

        def attach() -> None:
            plugin = self._link.requests.plugin(Camera)
            handle = plugin.subscribe_camera_list(self._cameras_listed)
            off.append(partial(plugin.unsubscribe_camera_list, handle))

        off.append(self._link.when_attached(attach))
        return off

    async def choose(self) -> Choice:
        """Return when there is a camera to use: see `camera_choice.choose`.

        A shutter of the autopilot, or one of several, is chosen only after the others had time to tell what they are.

        Raises:
            DeviceError: there is PX4's own trigger, but it cannot be used.
        """
        since = time.monotonic()
        while True:
            self._changed.clear()
            await self._ask_for_flags()
            waited = time.monotonic() - since > _PREFER_S
            candidates = self.candidates
            found = choose(candidates, component=self._component, image_px=self._image_px)
            known = {one.component for one in candidates}
            untold = [component for component in self.beating if component not in known]
            if found is not None and (self._component or waited or not (untold or found.camera.by_autopilot)):
                return found
            takes_photos = found is not None or any(one.takes_photos for one in candidates)
            if waited and not takes_photos and (trigger := await self._px4_trigger()) is not None:
                return trigger
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_LOOK_S):
                    await self._changed.wait()

    async def _px4_trigger(self) -> Choice | None:
        """PX4's own trigger, if it is set up: it answers no request about a camera."""
        if self._link.is_ardupilot or self._component not in {0, AUTOPILOT}:
            return None
        if self._trigger_mode is None:
            value = await self._link.requests.parameter("TRIG_MODE")
            self._trigger_mode = None if value is None else int(value)
        mode = self._trigger_mode
        if mode in _BY_ITSELF:
            raise DeviceError(
                f"PX4's camera trigger fires by itself (TRIG_MODE {mode}), so its photos cannot be told from those "
                "that are asked for: set TRIG_MODE = 1 and reboot",
                advice="TRIG_MODE = 1, and reboot",
            )
        by_key = self._component == AUTOPILOT and mode is None
        if mode not in _TRIGGER_MODES and not by_key:
            return None
        reason = "[camera] component" if by_key else f"TRIG_MODE {mode}, and no camera answers"
        return Choice(camera=CameraCandidate(component=AUTOPILOT), reason=reason)

    def none_found(self, timeout_s: float) -> DeviceError:
        """The error that says why there is no camera to use, and what to set where that is known.

        Args:
            timeout_s: how long it was looked for.
        """
        advice = ""
        if not self._link.connected:
            why = "no heartbeat from the autopilot"
        elif why := self._why_none_answers():
            pass
        elif why := self._link.identity.foreign(MAV_TYPE_CAMERA, "camera"):
            advice = f"the camera's own settings: system id {self._link.identity.system}"
        elif self._link.is_ardupilot:
            why = (
                "no component answers requests for CAMERA_INFORMATION (259); camera on a servo or relay: set CAM1_TYPE "
                "(ArduPilot) and reboot; MAVLink camera: is it on, and does the autopilot forward its messages?"
            )
        else:
            why, advice = self._why_no_px4_camera()
        return DeviceError(f"no camera within {timeout_s:g} s: {why}", advice=advice)

    def _why_none_answers(self) -> str:
        candidates = self.candidates
        if why := why_none(candidates, component=self._component):
            return why
        seen = ", ".join(str(one.component) for one in candidates) or "none"
        if self._component and candidates:
            return f"component {self._component} is configured, but MAVSDK found: {seen}"
        if untold := [component for component in self.beating if component not in self._flags]:
            return f"component {untold[0]} sends camera heartbeats but no CAMERA_INFORMATION (259) on request"
        return ""

    def _why_no_px4_camera(self) -> tuple[str, str]:
        text = "no component answers requests for CAMERA_INFORMATION (259)"
        if self._trigger_mode is None:
            text += (
                ", and TRIG_MODE cannot be read: PX4's own camera trigger is used with [camera] component = 1; "
                "MAVLink camera: is it on, and does the autopilot forward its messages?"
            )
            return text, "set [camera] component = 1 if TRIG_MODE is 1, or connect a MAVLink camera"
        return f"{text}, and PX4's own camera trigger is off (TRIG_MODE {self._trigger_mode})", ""

    async def _ask_for_flags(self) -> None:
        """Ask listed cameras whose own message was not seen: it came before there was a subscription, or was lost."""
        now = time.monotonic()
        missing = [component for component in self._listed if component not in self._flags]
        if not missing or now - self._asked_s < _ASK_AGAIN_S:
            return
        self._asked_s = now
        for component in missing:
            target = AUTOPILOT if component <= LAST_OF_AUTOPILOT else component
            with contextlib.suppress(DeviceError):
                await self._link.requests.command(REQUEST_MESSAGE, [CAMERA_INFORMATION], component=target)

    # --- in MAVSDK's thread

    def _informed(self, message: MavMessage) -> None:
        self._link.post(self._take_flags, message)

    def _cameras_listed(self, cameras: CameraList, _user_data: object) -> None:
        self._link.post(self._take_list, {camera.component_id: camera for camera in cameras.cameras})

    # --- on the loop

    def _take_flags(self, message: MavMessage) -> None:
        component = message.component_id
        if component == AUTOPILOT:
            component = int(message.fields.get("camera_device_id") or 0) or AUTOPILOT
        self._flags[component] = int(message.fields["flags"])
        self._changed.set()

    def _take_list(self, listed: dict[int, Information]) -> None:
        self._listed = listed
        self._changed.set()
