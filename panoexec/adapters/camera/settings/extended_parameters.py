"""The parameters of a MAVLink component by the extended parameter protocol, through the link's own messages.

Source: MAVLink common.xml, PARAM_EXT_REQUEST_READ (320), PARAM_EXT_VALUE (322), PARAM_EXT_SET (323), PARAM_EXT_ACK
(324), MAV_PARAM_EXT_TYPE. MAVSDK's camera plugin would fetch a camera definition from any host that a message names,
without a limit of size or time, and its parameter plugin reads 32-bit types alone.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.message_hub import MavMessage
from panoexec.clock import work
from panoexec.errors import DeviceError

_TRIES: Final = 3
_ANSWER_S: Final = 0.8
_IN_PROGRESS_S: Final = 5.0
_VALUE_BYTES: Final = 128
_CUSTOM: Final = 11
_FORMATS: Final = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i", 7: "<Q", 8: "<q", 9: "<f", 10: "<d"}
"""By MAV_PARAM_EXT_TYPE."""
_ACCEPTED, _IN_PROGRESS = 0, 3
_REFUSALS: Final = {1: "this value is not supported now", 2: "failed"}


@dataclass(frozen=True, slots=True)
class ExtendedValue:
    """A value as a component told it.

    Attributes:
        value: a number, or the text of a custom type.
        kind: MAV_PARAM_EXT_TYPE.
    """

    value: float | str
    kind: int


def decoded(raw: Sequence[int] | str, kind: int) -> float | str:
    """The value in the bytes of PARAM_EXT_VALUE.

    Raises:
        ValueError: there is no such type, or too few bytes.
    """
    data = raw.encode() if isinstance(raw, str) else bytes(raw)
    if kind == _CUSTOM:
        return data.split(b"\0")[0].decode(errors="replace")
    form = _FORMATS.get(kind)
    if form is None:
        raise ValueError(f"type {kind} of a parameter is unknown")
    try:
        return struct.unpack_from(form, data.ljust(_VALUE_BYTES, b"\0"))[0]  # type: ignore[no-any-return]
    except struct.error as error:
        raise ValueError(str(error)) from error


def encoded(text: str, kind: int) -> list[int]:
    """A value for PARAM_EXT_SET, 128 bytes.

    Args:
        text: as a camera definition writes it.
        kind: MAV_PARAM_EXT_TYPE.

    Raises:
        ValueError: the type cannot hold it.
    """
    try:
        if kind == _CUSTOM:
            data = text.encode()
        elif _FORMATS.get(kind) in {"<f", "<d"}:
            data = struct.pack(_FORMATS[kind], float(text))
        else:
            data = struct.pack(_FORMATS[kind], _whole(text))
    except (struct.error, KeyError, OverflowError) as error:
        raise ValueError(f"{text!r} does not fit into a parameter of type {kind}") from error
    if len(data) > _VALUE_BYTES:
        raise ValueError(f"{text!r} is longer than {_VALUE_BYTES} bytes")
    return list(data.ljust(_VALUE_BYTES, b"\0"))


def _whole(text: str) -> int:
    try:
        return int(text, 0)
    except ValueError:
        number = float(text)
        if not number.is_integer():
            raise ValueError(f"{text!r} is no integer") from None
        return int(number)


class ExtendedParameters:
    """Reads and sets parameters of one component, one at a time."""

    def __init__(self, link: MavsdkLink, *, component: Callable[[], int]) -> None:
        """Create it; nothing is sent.

        Args:
            link: to the vehicle.
            component: returns the component.
        """
        self._link = link
        self._component = component
        self._one = asyncio.Lock()

    async def read(self, name: str) -> ExtendedValue:
        """A parameter's value.

        Raises:
            DeviceError: the component did not answer, or its answer makes no sense.
        """
        async with self._one:
            fields = await self._asked("PARAM_EXT_VALUE", name, "PARAM_EXT_REQUEST_READ", {"param_index": -1})
        kind = int(fields["param_type"])
        try:
            return ExtendedValue(decoded(fields["param_value"], kind), kind)
        except ValueError as error:
            raise DeviceError(f"the camera's value of {name}: {error}") from error

    async def write(self, name: str, text: str, kind: int) -> None:
        """Set a parameter.

        Args:
            name: of the parameter.
            text: its value as a camera definition writes it.
            kind: its type, as the component told it.

        Raises:
            DeviceError: refused, or not answered.
        """
        try:
            value = encoded(text, kind)
        except ValueError as error:
            raise DeviceError(f"{name}: {error}") from error
        async with self._one:
            sent = {"param_value": value, "param_type": kind}
            fields = await self._asked("PARAM_EXT_ACK", name, "PARAM_EXT_SET", sent)
        result = int(fields["param_result"])
        if result != _ACCEPTED:
            why = _REFUSALS.get(result, f"result {result}")
            raise DeviceError(f"the camera does not take {text} for {name}: {why}")

    async def _asked(self, answer: str, name: str, request: str, more: dict[str, Any]) -> dict[str, Any]:
        """Send a request until it is answered; returns the answer's fields.

        Raises:
            DeviceError: not answered.
        """
        link, component = self._link, self._component()
        arrived: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

        def take(message: MavMessage) -> None:
            if message.component_id == component and str(message.fields["param_id"]).rstrip("\0") == name:
                link.post(arrived.put_nowait, message.fields)

        fields = {"target_system": link.requests.system_id, "target_component": component, "param_id": name, **more}
        off = link.on(answer, take)
        try:
            for _ in range(_TRIES):
                await link.requests.send(f"asking the camera for {name}", request, fields)
                patience_s = _ANSWER_S
                with work(link.clock):
                    while (told := await _within(arrived, patience_s)) is not None:
                        if told.get("param_result") != _IN_PROGRESS:
                            return told
                        patience_s = _IN_PROGRESS_S
        finally:
            off()
        raise DeviceError(f"the camera does not answer about {name} ({request})")


async def _within(queue: asyncio.Queue[dict[str, Any]], patience_s: float) -> dict[str, Any] | None:
    try:
        async with asyncio.timeout(patience_s):
            return await queue.get()
    except TimeoutError:
        return None
