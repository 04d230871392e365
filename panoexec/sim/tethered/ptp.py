"""Data sets of PTP (ISO 15740) as a camera sends them. Pure; little-endian throughout."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

STORE: Final = 0x00010001
"""The storage id of the card."""
ALL: Final = 0xFFFFFFFF
"""A wildcard for storage ids; as a parent: the root."""


class Op(IntEnum):
    """Operation codes."""

    GET_DEVICE_INFO = 0x1001
    OPEN_SESSION = 0x1002
    CLOSE_SESSION = 0x1003
    GET_STORAGE_IDS = 0x1004
    GET_STORAGE_INFO = 0x1005
    GET_NUM_OBJECTS = 0x1006
    GET_OBJECT_HANDLES = 0x1007
    GET_OBJECT_INFO = 0x1008
    GET_OBJECT = 0x1009
    GET_THUMB = 0x100A
    INITIATE_CAPTURE = 0x100E
    GET_PROPERTY_DESCRIPTION = 0x1014
    GET_PROPERTY_VALUE = 0x1015
    SET_PROPERTY_VALUE = 0x1016
    GET_PARTIAL_OBJECT = 0x101B


class Answer(IntEnum):
    """Response codes."""

    OK = 0x2001
    GENERAL_ERROR = 0x2002
    SESSION_NOT_OPEN = 0x2003
    OPERATION_NOT_SUPPORTED = 0x2005
    INVALID_STORAGE = 0x2008
    INVALID_HANDLE = 0x2009
    PROPERTY_NOT_SUPPORTED = 0x200A
    STORE_FULL = 0x200C
    STORE_READ_ONLY = 0x200E
    ACCESS_DENIED = 0x200F
    NO_THUMBNAIL = 0x2010
    STORE_NOT_AVAILABLE = 0x2013
    DEVICE_BUSY = 0x2019
    INVALID_VALUE = 0x201C
    SESSION_ALREADY_OPEN = 0x201E


class Told(IntEnum):
    """Event codes."""

    OBJECT_ADDED = 0x4002
    PROPERTY_CHANGED = 0x4006
    STORE_FULL = 0x400A
    CAPTURE_COMPLETE = 0x400D


class Format(IntEnum):
    """Object format codes."""

    UNDEFINED = 0x3000
    FOLDER = 0x3001
    JPEG = 0x3801


class Kind(IntEnum):
    """Data types of properties."""

    UINT8 = 0x0002
    INT16 = 0x0003
    UINT16 = 0x0004
    UINT32 = 0x0006


_CODES: Final = {Kind.UINT8: "B", Kind.INT16: "h", Kind.UINT16: "H", Kind.UINT32: "I"}
_EVENTS: Final = tuple(Told)


@dataclass(slots=True, kw_only=True)
class Property:
    """A setting of the camera.

    Attributes:
        code: device property code.
        kind: its data type.
        value: now.
        choices: what it can be set to; one choice alone cannot be set.
    """

    code: int
    kind: Kind
    value: int
    choices: tuple[int, ...]

    def packed(self, value: int) -> bytes:
        """A value on the wire."""
        return struct.pack("<" + _CODES[self.kind], value)

    def unpacked(self, data: bytes) -> int | None:
        """A value from the wire; None if it has the wrong length."""
        code = "<" + _CODES[self.kind]
        return int(struct.unpack(code, data)[0]) if len(data) == struct.calcsize(code) else None

    def description(self) -> bytes:
        """DevicePropDesc, with an enumeration of the choices."""
        writable = len(self.choices) > 1
        head = struct.pack("<HHB", self.code, self.kind, int(writable))
        values = b"".join(map(self.packed, self.choices))
        return head + self.packed(self.choices[0]) + self.packed(self.value) + b"\2" + _u16(len(self.choices)) + values


def text(value: str) -> bytes:
    """A string: number of UTF-16 units with the final zero, then those; empty: a zero byte."""
    if not value:
        return b"\0"
    units = (value + "\0").encode("utf-16-le")
    return bytes([len(units) // 2]) + units


def array32(values: Sequence[int]) -> bytes:
    """An array of 32-bit numbers."""
    return struct.pack(f"<I{len(values)}I", len(values), *values)


def _u16(value: int) -> bytes:
    return struct.pack("<H", value)


def _array16(values: Sequence[int]) -> bytes:
    return struct.pack(f"<I{len(values)}H", len(values), *values)


def device_info(*, properties: Sequence[int], vendor: str, model: str, serial: str) -> bytes:
    """DeviceInfo of a camera without extensions of a vendor."""
    return b"".join(
        (
            struct.pack("<HIH", 100, 0, 0),
            text(""),
            _u16(0),
            _array16(tuple(Op)),
            _array16(_EVENTS),
            _array16(properties),
            _array16((Format.JPEG,)),
            _array16((Format.JPEG, Format.FOLDER, Format.UNDEFINED)),
            text(vendor),
            text(model),
            text("1.0"),
            text(serial),
        )
    )


def storage_info(*, size_bytes: int, free_bytes: int, free_images: int, read_only: bool) -> bytes:
    """StorageInfo of a removable card with a DCF file system."""
    return (
        struct.pack(
            "<HHHQQI", 4, 3, int(read_only), size_bytes, max(0, free_bytes), min(max(0, free_images), 0xFFFFFFFE)
        )
        + text("SIM")
        + text("")
    )


def object_info(
    *, name: str, form: int, size_bytes: int, parent: int, stamp: str, width_px: int = 0, height_px: int = 0
) -> bytes:
    """ObjectInfo; `stamp` is YYYYMMDDThhmmss."""
    folder = form == Format.FOLDER
    return (
        struct.pack("<IHHI", STORE, form, 0, size_bytes)
        + struct.pack("<HIII", 0, 0, 0, 0)
        + struct.pack("<III", width_px, height_px, 24)
        + struct.pack("<IHII", parent, int(folder), 0, 0)
        + text(name)
        + text(stamp)
        + text(stamp)
        + text("")
    )
