"""Commands to a gimbal's manager: by MAVSDK, or directly to a manager that MAVSDK does not list.

MAVSDK 4.1 lists one manager for a gimbal device id, the first that answers. With PX4 and a gimbal that is a manager
itself both offer device 154, and which of them is listed is by chance. So the autopilot's manager is commanded directly
where it is not listed: MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE (1001) and MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW (1000).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

from mavsdk.plugins.gimbal import ControlMode, Gimbal, GimbalMode, SendMode

from panoexec.adapters.link.mavsdk_errors import MAV_RESULTS
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.errors import DeviceError

_PITCH_YAW: Final = 1000
_CONFIGURE: Final = 1001
_UNCHANGED: Final = -1
_GIVE: Final = -3
"""Parameters of 1001: leave a control as it is; give it up if we have it."""
_LEVEL: Final = 4 | 8
_YAW_LOCK: Final = 16
"""GIMBAL_MANAGER_FLAGS: roll and pitch relative to the horizon; yaw from north."""


class ManagerCommands:
    """Takes, points and releases gimbals; each call raises `DeviceError` if the manager refuses or is silent."""

    def __init__(self, link: MavsdkLink) -> None:
        self._link = link

    async def take(self, gimbal_id: int, *, manager: int, device_id: int) -> None:
        """Take the primary control.

        Args:
            gimbal_id: in MAVSDK's list; negative if it is not in it.
            manager: component of the manager.
            device_id: gimbal device id.
        """
        what = "taking control of the gimbal"
        if gimbal_id < 0:
            parameters = [*self._link.own_ids, _UNCHANGED, _UNCHANGED, 0, 0, device_id]
            await self._send(_CONFIGURE, parameters, manager=manager, what=what)
        else:
            take = partial(self._plugin.take_control, gimbal_id, ControlMode.PRIMARY)
            await self._link.requests.mavsdk_call(what, take)

    async def point(
        self, gimbal_id: int, *, manager: int, device_id: int, pitch_deg: float, yaw_deg: float | None
    ) -> None:
        """Point it.

        Args:
            gimbal_id: in MAVSDK's list; negative if it is not in it.
            manager: component of the manager.
            device_id: gimbal device id.
            pitch_deg: from the horizon.
            yaw_deg: from north, [-180, 180); None: along the heading.
        """
        where = "along the heading" if yaw_deg is None else f"yaw {yaw_deg:.1f}°"
        what, follows = f"pointing the gimbal at pitch {pitch_deg:.1f}° {where}", yaw_deg is None
        yaw = 0.0 if yaw_deg is None else yaw_deg
        if gimbal_id < 0:
            parameters = [pitch_deg, yaw, 0, 0, _LEVEL if follows else _LEVEL | _YAW_LOCK, 0, device_id]
            await self._send(_PITCH_YAW, parameters, manager=manager, what=what)
            return
        mode = GimbalMode.YAW_FOLLOW if follows else GimbalMode.YAW_LOCK
        set_angles = partial(self._plugin.set_angles, gimbal_id, 0.0, pitch_deg, yaw, mode, SendMode.ONCE)
        await self._link.requests.mavsdk_call(what, set_angles)

    async def release(self, gimbal_id: int, *, manager: int, device_id: int) -> None:
        """Give up the primary control.

        Args:
            gimbal_id: in MAVSDK's list; negative if it is not in it.
            manager: component of the manager.
            device_id: gimbal device id.
        """
        what = "releasing the gimbal"
        if gimbal_id < 0:
            parameters = [_GIVE, _GIVE, _UNCHANGED, _UNCHANGED, 0, 0, device_id]
            await self._send(_CONFIGURE, parameters, manager=manager, what=what)
        else:
            await self._link.requests.mavsdk_call(what, partial(self._plugin.release_control, gimbal_id))

    @property
    def _plugin(self) -> Gimbal:
        return self._link.requests.plugin(Gimbal)

    async def _send(self, command: int, parameters: Sequence[float], *, manager: int, what: str) -> None:
        result = await self._link.requests.command(command, parameters, component=manager)
        if result != 0:
            raise DeviceError(f"{what}: {MAV_RESULTS.get(result, result)}")
