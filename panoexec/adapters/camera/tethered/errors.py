"""What a user is told of a camera that cannot be used: what was found, and what to do."""

from __future__ import annotations

from typing import Final

_CLAIMED: Final = (
    "another program holds the camera (on a desktop gvfs: `systemctl --user stop gvfs-gphoto2-volume-monitor`, then "
    "`gio mount -s gphoto2`), or this user may not use the USB device (systemd/gphoto2.conf for the service)"
)
_NONE: Final = "no camera is connected by USB: check the cable, its power, and its USB mode (PTP, PC Remote or Tether)"
_NO_SPACE: Final = -115


def explained(kind: str, text: str, *, port: str, model: str, code: int = 0) -> str:
    """One line.

    Args:
        kind: of the `CameraError`.
        text: its text: what was found.
        port: as configured.
        model: as configured.
        code: libgphoto2's result code.
    """
    where = f" at [camera] port {port}" if port else ""
    if kind == "none":
        return f"no camera{where}; found: {text}" if text else _NONE
    texts = {
        "several": f"several cameras are connected: {text}; choose one by [camera] port or model",
        "model": f"[camera] model is {model!r}, but this camera is {text}",
        "claimed": f"{text}: {_CLAIMED}",
    }
    return f"{text}: its card is full" if code == _NO_SPACE else texts.get(kind, text)
