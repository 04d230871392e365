"""What every kind of camera offers beyond `devices.Camera`: how it is opened, found, watched and judged."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from panoexec.adapters.link.mavsdk_link import MavsdkLink
from panoexec.devices import Camera, EvidenceLevel
from panoexec.inputs.vehicle_sections import CameraSection


class CameraFound(Protocol):
    """What discovery found, in the terms that all kinds share."""

    @property
    def label(self) -> str:
        """Which camera it is, for people."""
        ...

    @property
    def why(self) -> str:
        """Why this camera was chosen; "" if there is no choice."""
        ...

    @property
    def is_two_way(self) -> bool:
        """Whether the camera answers, so that its image size and its free storage can be asked for."""
        ...

    @property
    def may_tell_files(self) -> bool:
        """Whether its reports may name image files that this computer can see."""
        ...

    @property
    def image_width_px(self) -> int:
        """0 if it does not say."""
        ...

    @property
    def image_height_px(self) -> int:
        """0 if it does not say."""
        ...


class OpenCamera(Camera, Protocol):
    """A camera of any kind on an open link."""

    @property
    def is_present(self) -> bool:
        """Whether it was found and has not been silent for too long."""
        ...

    @property
    def age_s(self) -> float:
        """Real seconds since the camera was last heard; infinity for one that never sends anything."""
        ...

    async def discover(self, timeout_s: float = 15.0) -> CameraFound:
        """Return when the camera is there.

        Args:
            timeout_s: real seconds.

        Raises:
            DeviceError: no camera; says what is missing.
            LinkError: no autopilot.
        """
        ...

    async def best_evidence(self) -> EvidenceLevel:
        """The best proof of a photo that this camera can give; only after `discover`.

        Raises:
            DeviceError: the autopilot could not be asked.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraKind:
    """One kind of camera; `open_camera.KINDS` lists them.

    Attributes:
        open: makes the camera that `[camera]` describes, on an open link, with a folder for files that no mission has
            taken yet; an async context manager, whose entry raises `PanoexecError` if the camera cannot be opened.
        settings: where to look when it is not found: configuration keys and files.
        needed: what is missing then; "" if the error says it all.
        set_by_autopilot: whether the autopilot's parameters decide too whether it is found.
    """

    open: Callable[[CameraSection, MavsdkLink, Path | None], AbstractAsyncContextManager[OpenCamera]]
    settings: str
    needed: str = ""
    set_by_autopilot: bool = False
