"""Reads a camera definition: which settings a MAVLink camera has, of which type, with which choices.

Source: MAVLink's Camera Definition File. What a definition says of other settings (exclusions, ranges that depend on
the mode) is not evaluated: a camera refuses what it cannot do now, and what it took over is read back.
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final
from xml.etree import ElementTree as ET

MAX_BYTES: Final = 1 << 20
"""Of a definition as the camera serves it."""
_MAX_TEXT_BYTES: Final = 4 << 20
_MAX_MEMORY_BYTES: Final = 64 << 20
_MAX_PARAMETERS: Final = 1000
_MAX_OPTIONS: Final = 1000
_XZ, _GZIP = b"\xfd7zXZ\x00", b"\x1f\x8b"
_NAME_BYTES: Final = 16
_TRUE: Final = ("1", "true")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One setting.

    Attributes:
        name: its id on the wire, at most 16 characters.
        options: its choices: name for people and value as text.
        read_only: it only tells.
    """

    name: str
    options: tuple[tuple[str, str], ...] = ()
    read_only: bool = False

    def choice_of(self, value: float | str) -> str:
        """The name of the choice with that value; the value itself where there is none."""
        for name, text in self.options:
            if is_same_value(value, text):
                return name
        return f"{value:.6g}" if isinstance(value, float) else str(value)

    def value_of(self, choice: str) -> str | None:
        """The value of the choice with that name; None if there is none."""
        return next((text for name, text in self.options if name == choice), None)


def is_same_value(value: float | str, text: str) -> bool:
    """Whether a value is the one that is written as `text`; both may be rounded to a 32-bit float."""
    if isinstance(value, str):
        return value == text
    try:
        other = float(text)
    except ValueError:
        return False
    return abs(value - other) <= 1e-5 * abs(other)


def read_definition(data: bytes) -> Mapping[str, Parameter]:
    """The settings of a camera, by name.

    Args:
        data: the file: XML, or compressed with xz or gzip.

    Raises:
        ValueError: it is no camera definition; says why.
    """
    text = _unpacked(data)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("it has a document type, which no camera definition has")
    try:
        root = ET.fromstring(text)  # noqa: S314  (bounded, and no entities can be declared without a document type)
    except ET.ParseError as error:
        raise ValueError(f"it is no XML ({error})") from error
    if root.tag != "mavlinkcamera":
        raise ValueError(f"its root is <{root.tag[:40]}>, not <mavlinkcamera>")
    found: dict[str, Parameter] = {}
    for element in root.iterfind("./parameters/parameter"):
        name = element.get("name", "").strip()
        if not 0 < len(name.encode()) <= _NAME_BYTES or len(found) >= _MAX_PARAMETERS:
            continue
        found.setdefault(name, _parameter(name, element))
    if not found:
        raise ValueError("it has no parameters")
    return found


def _parameter(name: str, element: ET.Element) -> Parameter:
    options = [
        (option.get("name", "").strip(), option.get("value", "").strip())
        for option in element.iterfind("./options/option")
    ]
    if not options and element.get("type") == "bool":
        options = [("Off", "0"), ("On", "1")]
    return Parameter(
        name=name,
        options=tuple(one for one in options[:_MAX_OPTIONS] if all(one)),
        read_only=element.get("readonly", "").strip().lower() in _TRUE,
    )


def _unpacked(data: bytes) -> str:
    """The text of a definition.

    Raises:
        ValueError: it is none, or too large.
    """
    try:
        if data.startswith(_XZ):
            data = lzma.LZMADecompressor(memlimit=_MAX_MEMORY_BYTES).decompress(data, _MAX_TEXT_BYTES + 1)
        elif data.startswith(_GZIP):
            data = zlib.decompressobj(wbits=31).decompress(data, _MAX_TEXT_BYTES + 1)
    except (lzma.LZMAError, zlib.error) as error:
        raise ValueError(f"it cannot be decompressed ({error})") from error
    if len(data) > _MAX_TEXT_BYTES:
        raise ValueError(f"it is larger than {_MAX_TEXT_BYTES} bytes")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError("it is no UTF-8") from error
