"""An open connection with heartbeats, before anything else of the daemon is loaded.

Autopilots may act on a companion computer that falls silent: ArduPilot's script `companion_watchdog` lands a copter in
GUIDED 3 s after the last heartbeat of component 191. After a crash the daemon therefore beats first and loads its
modules, which takes seconds on a small computer, afterwards (`python -m tests.bench heartbeats`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import structlog
from mavsdk import Configuration, Mavsdk

from panoexec.adapters.link.connection import close_connection, open_connection
from panoexec.adapters.link.connection_url import ConnectionUrl
from panoexec.adapters.link.mavsdk_errors import quiet_mavsdk_log
from panoexec.adapters.link.serial_ports import connection_of
from panoexec.errors import DeviceError
from panoexec.inputs.vehicle_sections import VehicleSection

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
        mavsdk = new_mavsdk(*ids)
        try:
            return OpenedConnection(url=url, ids=ids, mavsdk=mavsdk, handle=open_connection(mavsdk, url))
        except BaseException:
            mavsdk.destroy()
            raise
    except DeviceError as error:
        _log.debug("connection failed at once", error=str(error))
        return None
