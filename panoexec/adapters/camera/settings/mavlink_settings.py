"""The settings of a MAVLink camera, by its camera definition, in the form in which `LockedSettings` asks for them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import structlog

from panoexec.adapters.camera.settings.definition import MAX_BYTES, Parameter, read_definition
from panoexec.adapters.camera.settings.extended_parameters import ExtendedParameters
from panoexec.adapters.files.camera_served import served_file
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.clock import work
from panoexec.errors import DeviceError, PhotoFileError

CAMERA_INFORMATION: Final = 259
DEFINITION_S: Final = 8.0
"""How long the definition of a camera may take to arrive."""

_log = structlog.get_logger(__name__)


class NoSettingsError(DeviceError):
    """The camera offers no settings over MAVLink; says why."""


class MavlinkSettings:
    """Reads and sets what a camera definition names; the definition is fetched once and kept."""

    def __init__(self, link: MavsdkLink, *, component: Callable[[], int]) -> None:
        """Create it; nothing is sent.

        Args:
            link: to the vehicle.
            component: returns the camera's component.
        """
        self._link = link
        self._component = component
        self._extended = ExtendedParameters(link, component=component)
        self._defined: Mapping[str, Parameter] = {}
        self._defining = asyncio.Lock()

    async def call(self, what: str, timeout_s: float, **fields: Any) -> Any:
        """See `locked_settings.Call`.

        Raises:
            NoSettingsError: the camera has no definition that can be used.
            DeviceError: it refused, or did not answer in time.
        """
        defined = await self.defined()
        try:
            async with asyncio.timeout(timeout_s):
                if what == "read":
                    return await self._read(defined, fields["names"])
                return await self._set(defined[fields["name"]], fields["value"])
        except TimeoutError as error:
            raise DeviceError(f"the camera did not tell its settings within {timeout_s:g} s") from error

    async def defined(self) -> Mapping[str, Parameter]:
        """The settings that the camera's definition names.

        Raises:
            NoSettingsError: the camera has no definition that can be used.
            DeviceError: it did not answer.
        """
        async with self._defining:
            if not self._defined:
                self._defined = await self._fetched()
            return self._defined

    async def _fetched(self) -> Mapping[str, Parameter]:
        link, component = self._link, self._component()
        told = await link.requests.message(CAMERA_INFORMATION, "CAMERA_INFORMATION", component=component)
        uri = str(told.fields["cam_definition_uri"]).rstrip("\0")
        if not uri:
            raise NoSettingsError("it tells no camera definition (CAMERA_INFORMATION)")
        if not uri.isprintable():
            raise NoSettingsError("the URI of its camera definition has characters that no URI has")
        try:
            with work(link.clock):
                served = served_file(
                    link, uri, component=component, max_bytes=MAX_BYTES, timeout_s=DEFINITION_S, documents=True
                )
                async with served as path:
                    defined = await asyncio.to_thread(lambda: read_definition(path.read_bytes()))
        except (PhotoFileError, ValueError, OSError) as error:
            text = str(error) if isinstance(error, PhotoFileError) else f"{uri}: {error}"
            raise NoSettingsError(f"its camera definition cannot be used: {text}") from error
        _log.info("camera definition read", uri=uri, parameters=len(defined))
        return defined

    async def _read(self, defined: Mapping[str, Parameter], names: Sequence[str]) -> dict[str, dict[str, Any]]:
        return {name: await self._told(defined[name]) for name in names if name in defined}

    async def _told(self, parameter: Parameter) -> dict[str, Any]:
        now = await self._extended.read(parameter.name)
        return {
            "value": parameter.choice_of(now.value),
            "choices": [name for name, _ in parameter.options],
            "read_only": parameter.read_only,
        }

    async def _set(self, parameter: Parameter, choice: str) -> dict[str, Any]:
        """Set a choice, or what a value was before that is no choice; returns the setting as it is then."""
        now = await self._extended.read(parameter.name)
        value = parameter.value_of(choice)
        await self._extended.write(parameter.name, choice if value is None else value, now.kind)
        return await self._told(parameter)
