"""How many photos a MAVLink camera's storages hold, by STORAGE_INFORMATION (261)."""

from __future__ import annotations

import math
from typing import Final

from panoexec.adapters.gimbal.attitude_messages import number
from panoexec.adapters.link.message_hub import MavMessage

_EMPTY, _UNFORMATTED, _READY = 0, 1, 2
_BYTES_PER_PX: Final = 0.6
"""Upper estimate for a high-quality JPEG: 14 MB for 24 megapixels."""


class CameraStorage:
    """The storages of one camera; `note` may be called in another thread."""

    def __init__(self, *, mib_per_image: float | None) -> None:
        """Create it.

        Args:
            mib_per_image: size of a photo; None: estimate it from the image's dimensions.
        """
        self._mib_per_image = mib_per_image
        self._free_mib: dict[int, float] = {}

    def note(self, message: MavMessage) -> None:
        """Take a STORAGE_INFORMATION."""
        fields = message.fields
        status, free = int(fields["status"]), number(fields["available_capacity"])
        storages = dict(self._free_mib)
        if status in {_EMPTY, _UNFORMATTED}:
            storages[int(fields["storage_id"])] = 0.0
        elif status == _READY and math.isfinite(free):
            storages[int(fields["storage_id"])] = free
        self._free_mib = storages

    def free_images(self, pixels: int) -> float:
        """How many photos of that many pixels fit; infinity if it is unknown."""
        if not self._free_mib:
            return math.inf
        size = pixels * _BYTES_PER_PX / 2**20 if self._mib_per_image is None else self._mib_per_image
        free = sum(self._free_mib.values())
        if size <= 0:
            return math.inf if free > 0 else 0.0
        return float(math.floor(free / size))
