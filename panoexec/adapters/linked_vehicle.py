"""Autopilot, gimbal and vehicle on one link, as the configuration describes them: for the daemon and for the doctor.

One place, so that what the doctor examines is what the daemon flies with.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from panoexec.adapters.gimbal.mavsdk_gimbal import MavsdkGimbal
from panoexec.adapters.link.connection_url import ConnectionUrl
from panoexec.adapters.link.file_urls import FileUrls
from panoexec.adapters.link.first_heartbeats import OpenedConnection
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.adapters.link.stream_health import DEFAULT_STREAMS, Stream
from panoexec.adapters.mavsdk_vehicle import MavsdkVehicle
from panoexec.clock import Clock
from panoexec.inputs.config import Config


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkedVehicle:
    """An open link and what is on it; none of it needs to have been found yet.

    Attributes:
        link: to the autopilot.
        gimbal: on the link.
        vehicle: on the link.
    """

    link: MavsdkLink
    gimbal: MavsdkGimbal
    vehicle: MavsdkVehicle


@asynccontextmanager
async def linked_vehicle(
    config: Config,
    url: ConnectionUrl,
    *,
    clock: Clock,
    patient: bool = False,
    throttling: bool = False,
    opened: OpenedConnection | None = None,
    guarded: bool = False,
    streams: Sequence[Stream] = DEFAULT_STREAMS,
) -> AsyncIterator[LinkedVehicle]:
    """Open the link that the configuration describes.

    Args:
        config: the daemon's.
        url: `connection_of(config.vehicle)`.
        clock: of missions.
        patient: see `MavsdkLink`.
        throttling: see `MavsdkLink`.
        opened: see `MavsdkLink`.
        guarded: see `MavsdkLink`.
        streams: see `MavsdkLink`.

    Raises:
        LinkError: the port is in use, or the device cannot be opened.
    """
    section, chosen = config.vehicle, config.gimbal
    link = MavsdkLink(
        url,
        clock=clock,
        component_id=section.component_id,
        vehicle_system_id=section.system_id,
        patient=patient,
        throttling=throttling,
        opened=opened,
        guarded=guarded,
        streams=streams,
        files=FileUrls(folders=file_folders(config), hosts=file_hosts(config, url)),
    )
    async with (
        link,
        MavsdkGimbal(
            link,
            feedback=None if chosen.feedback == "auto" else chosen.feedback,
            manager=chosen.manager,
            device=chosen.device,
        ) as gimbal,
        MavsdkVehicle(link) as vehicle,
    ):
        yield LinkedVehicle(link=link, gimbal=gimbal, vehicle=vehicle)


def file_folders(config: Config) -> tuple[Path, ...]:
    """The folders of this computer in which a camera's photos may be."""
    return (config.storage.path / "missions", *config.camera.file_folders)


def file_hosts(config: Config, url: ConnectionUrl) -> tuple[str, ...]:
    """The hosts that may serve a camera's photos: those configured, and the one that the link connects to."""
    own = () if url.listens or not url.host else (url.host,)
    return (*config.camera.file_hosts, *own)
