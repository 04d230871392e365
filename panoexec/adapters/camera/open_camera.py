"""The kinds of camera that `[camera] trigger` can name. Nothing else in panoexec knows which there are.

To add a kind: write its module with a `KIND`, list it here, and allow its name in `CameraSection.trigger`.
"""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Final

from panoexec.adapters.camera import mavsdk_camera, serial_shutter
from panoexec.adapters.camera.camera_kind import CameraKind, OpenCamera
from panoexec.adapters.camera.tethered import camera as tethered
from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.inputs.vehicle_sections import CameraSection

KINDS: Final[dict[str, CameraKind]] = {
    "mavlink": mavsdk_camera.KIND,
    "serial": serial_shutter.KIND,
    "gphoto2": tethered.KIND,
}
"""By the value of `[camera] trigger`."""


def open_camera(
    section: CameraSection, link: MavsdkLink, *, spool: Path | None = None
) -> AbstractAsyncContextManager[OpenCamera]:
    """The camera that the configuration describes; `OpenCamera.discover` finds it once the context is entered.

    Args:
        section: `[camera]`.
        link: to the autopilot, entered before and left after this. Its clock is the mission's.
        spool: folder for files of photos that no mission has taken yet; None: a temporary one.

    Raises:
        DeviceError: on entry, if it cannot be opened.
        DependencyError: on entry, if what it needs is not installed.
    """
    return KINDS[section.trigger].open(section, link, spool)
