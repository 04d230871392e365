"""An open connection with heartbeats, before anything else of the daemon is loaded.

Autopilots may act on a companion computer that falls silent: ArduPilot's script `companion_watchdog` lands a copter in
GUIDED 3 s after the last heartbeat of component 191. After a crash the daemon therefore beats first and loads its
modules, which takes seconds on a small computer, afterwards (`python -m tests.bench heartbeats`).

MAVSDK sends its first heartbeat when it opens a connection, and the next one a second later. On a UDP port that listens
the first one goes nowhere, because nobody has been heard yet. So the heartbeat of that moment is sent here, to whoever
sends to the port, before MAVSDK has it.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from dataclasses import dataclass
from typing import Any, Final

import structlog
from mavsdk import Configuration, Mavsdk

from panoexec.adapters.link.connection import close_connection, listening, open_connection
from panoexec.adapters.link.connection_url import ConnectionUrl
from panoexec.adapters.link.mavsdk_errors import quiet_mavsdk_log
from panoexec.adapters.link.serial_ports import connection_of
from panoexec.errors import DeviceError
from panoexec.inputs.vehicle_sections import VehicleSection

_FIRST_S: Final = 0.3
"""So long a vehicle is waited for: it sends dozens of packets a second."""
_OTHERS_S: Final = 0.05
"""So long after the first sender, others are waited for."""
_CRC_EXTRA: Final = 50
"""Of HEARTBEAT, in its checksum (MAVLink's common.xml)."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenedConnection:
    """A MAVSDK instance with its connection, which sends heartbeats.

    Attributes:
        url: what it is connected to.
        ids: own MAVLink system and component ids.
        mavsdk: the instance.
        handle: of the connection.
    """

    url: ConnectionUrl
    ids: tuple[int, int]
    mavsdk: Mavsdk
    handle: Any

    def close(self) -> None:
        """End the heartbeats."""
        close_connection(self.mavsdk, self.handle)
        self.mavsdk.destroy()


def new_mavsdk(system_id: int, component_id: int) -> Mavsdk:
    """A MAVSDK instance that sends heartbeats with these ids as soon as it has a connection."""
    configuration = Configuration.create_manual(system_id, component_id, always_send_heartbeats=True)
    try:
        return Mavsdk(configuration)
    finally:
        configuration.destroy()


def open_at_once(section: VehicleSection) -> OpenedConnection | None:
    """Open the configured connection; None if that fails, which the daemon's own attempt will tell.

    Args:
        section: of the configuration.
    """
    quiet_mavsdk_log()
    ids = (section.system_id or 1, section.component_id)
    try:
        url = connection_of(section)
        if url.kind == "udpin":
            _answer_with_a_heartbeat(listening(url), ids)
        mavsdk = new_mavsdk(*ids)
        try:
            return OpenedConnection(url=url, ids=ids, mavsdk=mavsdk, handle=open_connection(mavsdk, url))
        except BaseException:
            mavsdk.destroy()
            raise
    except DeviceError as error:
        _log.debug("connection failed at once", error=str(error))
        return None


def _answer_with_a_heartbeat(url: ConnectionUrl, ids: tuple[int, int]) -> None:
    """Send a heartbeat to whoever sends to the port; an error is for MAVSDK to find."""
    frame, answered = heartbeat(*ids), set[Any]()
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind((url.host, url.port))
        end_s = time.monotonic() + _FIRST_S
        while (left_s := end_s - time.monotonic()) > 0:
            port.settimeout(left_s)
            _, sender = port.recvfrom(65535)
            if sender in answered:
                continue
            if not answered:
                end_s = min(end_s, time.monotonic() + _OTHERS_S)
            port.sendto(frame, sender)
            answered.add(sender)


def heartbeat(system_id: int, component_id: int) -> bytes:
    """A HEARTBEAT with the values that MAVSDK sends, as a MAVLink 2 packet with sequence number 0."""
    # custom_mode, MAV_TYPE_GENERIC, MAV_AUTOPILOT_INVALID, base_mode, system_status, mavlink_version
    payload = struct.pack("<IBBBBB", 0, 0, 8, 0, 0, 3)
    body = bytes([len(payload), 0, 0, 0, system_id, component_id, 0, 0, 0]) + payload
    return b"\xfd" + body + struct.pack("<H", _checksum(body + bytes([_CRC_EXTRA])))


def _checksum(data: bytes) -> int:
    """CRC-16/MCRF4XX, MAVLink's."""
    crc = 0xFFFF
    for byte in data:
        part = byte ^ (crc & 0xFF)
        part ^= (part << 4) & 0xFF
        crc = (crc >> 8) ^ (part << 8) ^ (part << 3) ^ (part >> 4)
    return crc
