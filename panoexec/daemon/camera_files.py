"""The ways in which the camera's files reach this computer, as configured now."""

from __future__ import annotations

from collections.abc import Callable

from panoexec.adapters.files.http_files import HttpFiles
from panoexec.adapters.files.mavlink_ftp import MavlinkFtpFiles
from panoexec.adapters.linked_vehicle import file_folders
from panoexec.daemon.vehicle_link import VehicleLink
from panoexec.inputs.config import Config
from panoexec.mission.protocols import PhotoFetcher
from panoexec.store.photo_collector import LocalFiles


class CameraFiles:
    """Owns the process that downloads files.

    Attributes:
        in_flight: returns whether a mission flies, which the link then belongs to.
    """

    def __init__(self, config: Callable[[], Config], vehicle: VehicleLink) -> None:
        """Describe it.

        Args:
            config: as of now.
            vehicle: whose camera it is.
        """
        self._config = config
        self._vehicle = vehicle
        self._http = HttpFiles(lambda: vehicle.file_hosts)
        self._ftp = MavlinkFtpFiles(
            lambda: None if vehicle.linked is None else vehicle.linked.link,
            component=lambda: config().camera.component or MavlinkFtpFiles.CAMERA,
            burst=lambda: not self.in_flight(),
        )
        self.in_flight: Callable[[], bool] = lambda: True

    def fetchers(self) -> tuple[PhotoFetcher, ...]:
        """One of each way."""
        camera = self._vehicle.camera
        tethered = (camera,) if isinstance(camera, PhotoFetcher) else ()
        return (LocalFiles(file_folders(self._config())), self._http, self._ftp, *tethered)

    async def close(self) -> None:
        """End what runs; it is started again when it is needed."""
        await self._http.close()
