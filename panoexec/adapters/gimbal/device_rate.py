"""Asks a gimbal itself for its attitude at full rate, where the autopilot does not forward the request.

A gimbal with a component of its own streams GIMBAL_DEVICE_ATTITUDE_STATUS (285) at a rate of its own, ten a second as
the description of the message suggests. The autopilot takes SET_MESSAGE_INTERVAL (511) for its copy only.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import Final

import structlog

from panoexec.adapters.gimbal.gimbal_reports import ATTITUDE_STATUS, GimbalReports
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.stream_keeper import AUTOPILOT, SET_MESSAGE_INTERVAL
from panoexec.errors import DeviceError

FULL_HZ: Final = 50.0
_ENOUGH_FRAC: Final = 0.8
_MEASURE_S: Final = 0.7
_TRIES: Final = 3

_log = structlog.get_logger(__name__)


class DeviceRate:
    """The rate of one gimbal's own reports."""

    def __init__(self, link: MavsdkLink, reports: GimbalReports) -> None:
        self._link = link
        self._reports = reports
        self._task: asyncio.Task[None] | None = None
        self._asked: int | None = None

    def begin(self) -> None:
        """Measure the rate in the background, and ask the gimbal if it is low."""
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self.ask(), name="rate of the gimbal's reports")

    async def stop(self) -> None:
        """End the background task."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
            self._task = None

    async def restore(self) -> None:
        """Ask for the gimbal's own rate again, if another one was asked for."""
        await self.stop()
        component, self._asked = self._asked, None
        if component is not None:
            with contextlib.suppress(DeviceError):
                await self._link.requests.command(SET_MESSAGE_INTERVAL, [ATTITUDE_STATUS, 0], component=component)

    async def ask(self) -> None:
        """Measure the rate, and ask the gimbal if it is low; takes a second or two of the mission's clock."""
        for _ in range(_TRIES):
            await self._link.clock.sleep(_MEASURE_S)
            component, rate_hz = self._reports.buffer.pinned, self._reports.rate_hz()
            if component in (None, AUTOPILOT) or rate_hz >= _ENOUGH_FRAC * FULL_HZ:
                return
            assert component is not None
            try:
                result = await self._link.requests.command(
                    SET_MESSAGE_INTERVAL, [ATTITUDE_STATUS, 1e6 / FULL_HZ], component=component
                )
            except DeviceError as error:
                _log.info("the gimbal does not answer the request for its rate", component=component, error=str(error))
                return
            _log.info("the gimbal was asked for its rate", component=component, hz=rate_hz, result=result)
            if result != 0:
                return
            self._asked = component
