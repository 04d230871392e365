"""Photo mode: set before the first photo, and the earlier mode restored.

A camera that was left in video mode denies photos, or takes frames of the video. Sources: MAVLink common.xml,
CAMERA_SETTINGS (260), MAV_CMD_SET_CAMERA_MODE (530), CAMERA_MODE; MAV_CMD_REQUEST_CAMERA_SETTINGS (522) for cameras
that do not know MAV_CMD_REQUEST_MESSAGE.
"""

from __future__ import annotations

import asyncio
import time
from typing import Final

import structlog

from panoexec.adapters.link.mavsdk_errors import MAV_RESULTS
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.errors import DeviceError

CAMERA_SETTINGS: Final = 260
SET_CAMERA_MODE: Final = 530
_IMAGE: Final = 0
MODES: Final[dict[int, str]] = {0: "photo mode", 1: "video mode", 2: "survey mode"}
"""Texts for CAMERA_MODE."""
_PHOTO_MODES: Final = (0, 2)
_CHANGED_S: Final = 3.0
_LOOK_S: Final = 0.25
_RESTORE_S: Final = 5.0

_log = structlog.get_logger(__name__)


class PhotoMode:
    """The mode of one MAVLink camera."""

    def __init__(self, link: MavsdkLink, component: int) -> None:
        """Create it; nothing is sent.

        Args:
            link: to the vehicle.
            component: of the camera.
        """
        self._link = link
        self._component = component
        self._before: int | None = None
        self.mode: int | None = None
        """The mode that the camera told last; None if it tells none."""

    @property
    def text(self) -> str:
        """The mode for people, "" if it is unknown."""
        return "" if self.mode is None else MODES.get(self.mode, f"mode {self.mode}")

    @property
    def takes_photos(self) -> bool:
        """Whether photos can be taken in this mode, as far as it is known."""
        return self.mode is None or self.mode in _PHOTO_MODES

    async def read(self) -> None:
        """Ask the camera for its mode.

        Raises:
            LinkError: no link. A camera that does not answer has no known mode.
        """
        try:
            message = await self._link.requests.message(CAMERA_SETTINGS, "CAMERA_SETTINGS", component=self._component)
            self.mode = int(message.fields["mode_id"])
        except DeviceError as error:
            _log.debug("camera mode unknown", component=self._component, error=str(error))
            self.mode = None

    async def ensure(self) -> str:
        """Set photo mode where it is not, and verify it; returns what prevents that, "" if nothing does."""
        await self.read()
        if self.takes_photos:
            return ""
        before, text = self.mode, self.text
        problem = await self._set(_IMAGE)
        if problem:
            return f"the camera is in {text} and stays there: {problem}"
        if self._before is None:
            self._before = before
        _log.info("camera set to photo mode", component=self._component, before=text)
        return ""

    async def restore(self) -> None:
        """Set the mode that `ensure` found; never raises."""
        before, self._before = self._before, None
        if before is None:
            return
        try:
            async with asyncio.timeout(_RESTORE_S):
                problem = await self._set(before)
        except (DeviceError, TimeoutError) as error:
            problem = str(error) or "not answered"
        if problem:
            _log.warning("camera mode not restored", mode=MODES.get(before), why=problem)
        else:
            _log.info("camera mode restored", mode=MODES.get(before))

    async def _set(self, mode: int) -> str:
        """Set a mode and wait until the camera tells it; returns what went wrong, "" for nothing."""
        try:
            result = await self._link.requests.command(SET_CAMERA_MODE, [0, mode], component=self._component)
        except DeviceError as error:
            return str(error)
        if result not in {0, 5}:
            return f"changing its mode (530): {MAV_RESULTS.get(result, result)}"
        deadline = time.monotonic() + _CHANGED_S
        while True:
            await self.read()
            if self.mode in {mode, None}:
                return ""
            if time.monotonic() > deadline:
                return "it accepted a change of its mode (530), but did not make it"
            await asyncio.sleep(_LOOK_S)
