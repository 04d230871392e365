"""The simulated camera's files by MAVLink FTP: list, open, read, read in a burst.

Source: MAVLink's File Transfer Protocol (message 110). The payload is sequence number (2 bytes), session, operation
code, size, requested operation, burst complete, padding, offset (4), data (at most 239).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Final, TypeAlias

from panoexec.sim.config import SimConfig
from panoexec.sim.mavlink.camera_settings import FILE_NAME, definition
from panoexec.sim.mavlink.component import Component
from panoexec.sim.mavlink.dialect import mavlink
from panoexec.sim.mavlink.wire import Message

FOLDER: Final = "/DCIM"
_HEAD = struct.Struct("<HBBBBBxI")
_DATA_BYTES: Final = 239
_BURST: Final = 60
"""Packets in one burst; the reader asks for the next one."""

_TERMINATE, _RESET, _LIST, _OPEN, _READ, _READ_BURST = 1, 2, 3, 4, 5, 15
_ACK, _NAK = 128, 129
_INVALID_SESSION, _EOF, _UNKNOWN, _NOT_FOUND = 4, 6, 7, 10

_Answer: TypeAlias = tuple[int, int, bytes, bool]
"""Result, offset, data, and whether a burst is complete."""


def mftp_url(path: Path) -> str:
    """The URL of a photo."""
    return f"mftp://[;comp={mavlink.MAV_COMP_ID_CAMERA}]{FOLDER}/{path.name}"


def definition_uri() -> str:
    """The URI of the camera definition."""
    return f"mftp://[;comp={mavlink.MAV_COMP_ID_CAMERA}]{FOLDER}/{FILE_NAME}"


def ftp_server_of(config: SimConfig, component: Component) -> FtpServer | None:
    """What the configured camera serves by MAVLink FTP; None if it serves nothing."""
    folder = config.output if config.camera.files == "mftp" else None
    besides = {FILE_NAME: definition()} if config.camera.definition == "mftp" else {}
    if folder is None and not besides:
        return None
    ids = component.sender.system_id, component.sender.component_id
    return FtpServer(folder, component, system_id=ids[0], component_id=ids[1], besides=besides)


class FtpServer:
    """Serves the JPEGs of one folder and files besides, one session at a time."""

    def __init__(
        self,
        folder: Path | None,
        component: Component,
        *,
        system_id: int,
        component_id: int,
        besides: Mapping[str, bytes] | None = None,
    ) -> None:
        """Describe it.

        Args:
            folder: where the photos are written; None: nowhere.
            component: sends the answers.
            system_id: own MAVLink system.
            component_id: own MAVLink component.
            besides: content of further files in the same folder, by name.
        """
        self._folder = folder
        self._besides = dict(besides or {})
        self._component = component
        self._ids = (system_id, component_id)
        self._open: bytes | None = None
        self._last: tuple[bytes, list[Message]] | None = None

    def receive(self, message: Message) -> None:
        """Answer a request that is addressed to this component; a repeated one gets the same answer."""
        if (message.target_system, message.target_component) != self._ids:
            return
        payload = bytes(message.payload)
        if self._last is None or self._last[0] != payload:
            number, session, code, size, _, _, offset = _HEAD.unpack_from(payload)
            data = payload[_HEAD.size : _HEAD.size + size]
            answers = self._answers(code, session, offset, data, size)
            to = message.get_srcSystem(), message.get_srcComponent()
            packed = [
                mavlink.MAVLink_file_transfer_protocol_message(0, *to, self._packed(number + 1 + i, code, answer))
                for i, answer in enumerate(answers)
            ]
            self._last = payload, packed
        for answer in self._last[1]:
            self._component.send(answer)

    def _packed(self, number: int, code: int, answer: _Answer) -> bytes:
        result, offset, data, complete = answer
        head = _HEAD.pack(number & 0xFFFF, 0, result, len(data), code, int(complete), offset)
        return (head + data).ljust(251, b"\0")

    def _answers(self, code: int, session: int, offset: int, data: bytes, size: int) -> list[_Answer]:
        """The answers to a request."""
        if code in {_TERMINATE, _RESET}:
            self._open = None
            return [(_ACK, 0, b"", False)]
        if code == _LIST:
            return [self._listed(data, offset)]
        if code == _OPEN:
            return [self._opened(data)]
        if code not in {_READ, _READ_BURST}:
            return [_refused(_UNKNOWN)]
        if session or self._open is None:
            return [_refused(_INVALID_SESSION)]
        return [self._read(offset, size)] if code == _READ else self._burst(offset)

    def _listed(self, data: bytes, skip: int) -> _Answer:
        if PurePosixPath(_text(data)) != PurePosixPath(FOLDER):
            return _refused(_NOT_FOUND)
        photos = [] if self._folder is None else sorted(self._folder.glob("*.jpg"))
        sizes = [(path.name, path.stat().st_size) for path in photos]
        sizes += [(name, len(content)) for name, content in self._besides.items()]
        entries = [f"F{name}\t{size}\0".encode() for name, size in sizes]
        found = b""
        for entry in entries[skip:]:
            if len(found) + len(entry) > _DATA_BYTES:
                break
            found += entry
        return (_ACK, skip, found, False) if found else _refused(_EOF)

    def _opened(self, data: bytes) -> _Answer:
        path = PurePosixPath(_text(data))
        content = self._besides.get(path.name)
        if str(path.parent) != FOLDER or (self._folder is None and content is None):
            return _refused(_NOT_FOUND)
        try:
            self._open = (self._folder / path.name).read_bytes() if self._folder and content is None else content
        except OSError:
            return _refused(_NOT_FOUND)
        assert self._open is not None
        return (_ACK, 0, struct.pack("<I", len(self._open)), False)

    def _read(self, offset: int, size: int) -> _Answer:
        assert self._open is not None
        found = self._open[offset : offset + min(size or _DATA_BYTES, _DATA_BYTES)]
        return (_ACK, offset, found, False) if found else _refused(_EOF)

    def _burst(self, offset: int) -> list[_Answer]:
        assert self._open is not None
        starts = range(offset, min(len(self._open), offset + _BURST * _DATA_BYTES), _DATA_BYTES)
        if not starts:
            return [_refused(_EOF)]
        return [(_ACK, at, self._open[at : at + _DATA_BYTES], at == starts[-1]) for at in starts]


def _refused(error: int) -> _Answer:
    return (_NAK, 0, bytes([error]), False)


def _text(data: bytes) -> str:
    return data.split(b"\0")[0].decode(errors="replace")
