"""The locked settings of one camera: made before a mission, again after the camera was away, put back after it."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final

import structlog

from panoexec.adapters.camera.settings import lock as locking
from panoexec.adapters.camera.settings.lock import Change
from panoexec.errors import DeviceError
from panoexec.formats.photo_settings import PhotoExif
from panoexec.inputs.vehicle_sections import LockSection

_READ_S: Final = 10.0
_SET_S: Final = 5.0
_OFF: Final = LockSection()

Call = Callable[..., Awaitable[Any]]
"""Asks the camera: what, seconds, fields. `read` with `names` returns the settings of these names that the camera has;
`set` with `name` and `value` returns that setting as it is then."""

_log = structlog.get_logger(__name__)


class LockedSettings:
    """What `[camera.lock]` asks for, on one camera.

    Attributes:
        focal_length_mm: as the camera tells it; NaN before, or if it does not.
    """

    def __init__(self, lock: LockSection, *, call: Call) -> None:
        """Create it; `call` asks the camera."""
        self.focal_length_mm = math.nan
        self._lock = lock
        self._call = call
        self._made: list[Change] = []
        self._metered = False

    @property
    def needs_metering(self) -> bool:
        """Whether the exposure is still to be metered."""
        return self._lock.exposure == "first" and not self._metered

    async def prepare(self) -> str:
        """Make the settings that need no metering; returns what prevents that, "" if nothing does.

        Raises:
            DeviceError: the camera is gone.
        """
        self._metered = False
        widgets = await self._read(self._call)
        self.focal_length_mm = _focal_length_mm(widgets)
        without = self._lock.model_copy(update={"exposure": "off"}) if self._lock.exposure == "first" else self._lock
        return "" if without == _OFF else await self._make(without, widgets, None)

    async def keep(self, metered: PhotoExif | None) -> str:
        """Set the exposure to what was metered; returns what prevents that.

        Raises:
            DeviceError: the camera is gone.
        """
        problem = await self._make(self._lock, await self._read(self._call), metered)
        self._metered = not problem
        return problem

    async def _make(self, lock: LockSection, widgets: locking.Widgets, metered: PhotoExif | None) -> str:
        try:
            planned = locking.changes(lock, widgets, metered=metered)
            before = {change.name: change.before for change in self._made}
            await locking.make(planned, self._set)
            self._made = [Change(one.what, one.name, one.value, before.get(one.name, one.before)) for one in planned]
        except locking.LockError as error:
            return str(error)
        _log.info("camera settings locked", **{change.name: change.value for change in planned})
        return "; ".join(locking.drifted(planned, await self._read(self._call)))

    async def again(self, call: Call) -> None:
        """Make them again on a camera that was opened anew.

        Raises:
            DeviceError: the camera is gone, or refused.
        """
        if not self._made:
            return

        async def set_value(name: str, value: str) -> Mapping[str, Any]:
            return dict(await call("set", _SET_S, name=name, value=value))

        widgets = await self._read(call)
        now = [
            Change(one.what, one.name, one.value, str(widgets[one.name]["value"]))
            for one in self._made
            if one.name in widgets
        ]
        await locking.make(now, set_value)

    async def restore(self) -> None:
        """Put back what was set, in the opposite order.

        Raises:
            DeviceError: the camera is gone.
        """
        made, self._made, self._metered = self._made, [], False
        for change in reversed(made):
            if change.before != change.value:
                try:
                    await self._set(change.name, change.before)
                except DeviceError as error:
                    _log.warning("camera setting not put back", setting=change.name, reason=str(error))

    async def _set(self, name: str, value: str) -> Mapping[str, Any]:
        return dict(await self._call("set", _SET_S, name=name, value=value))

    async def _read(self, call: Call) -> locking.Widgets:
        return dict(await call("read", _READ_S, names=list(locking.needed(self._lock))))


def _focal_length_mm(widgets: locking.Widgets) -> float:
    for name in locking.FOCAL_LENGTH:
        try:
            return float(str(widgets[name]["value"]).removesuffix("mm").strip())
        except (KeyError, ValueError):
            continue
    return math.nan
