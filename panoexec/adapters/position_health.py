"""Whether a position is to be trusted: by the GNSS receiver's own report and by the estimator's flags. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from panoexec.adapters.gimbal.attitude_messages import number

FIX_3D: Final = 3
"""GPS_FIX_TYPE: three-dimensional."""
ACCURACY_M: Final = 5.0
"""Horizontal accuracy (GPS_RAW_INT.h_acc) beyond which a position is not held; PX4 ends position control there, too
(COM_POS_FS_EPH)."""
HDOP: Final = 5.0
"""The same for receivers that report no accuracy."""

_NO_HDOP: Final = 65535
_POSITION_ABSOLUTE: Final = 16
_CONSTANT_POSITION: Final = 128
_GLITCH: Final = {193: 32768, 230: 1024}
"""GPS glitch in EKF_STATUS_REPORT (193, ArduPilot) and ESTIMATOR_STATUS (230, PX4)."""


def receiver_doubts(fields: Mapping[str, Any]) -> tuple[str, ...]:
    """What GPS_RAW_INT (24) says against the position.

    Args:
        fields: of the message.
    """
    fix = int(fields["fix_type"])
    if fix < FIX_3D:
        return (f"no 3D fix (fix type {fix})",)
    accuracy_m, hdop = number(fields.get("h_acc")) / 1e3, int(fields.get("eph") or _NO_HDOP)
    if accuracy_m > 0:  # 0 or NaN: not reported
        return (f"accuracy {accuracy_m:.1f} m",) if accuracy_m > ACCURACY_M else ()
    return (f"HDOP {hdop / 100:.1f}",) if hdop != _NO_HDOP and hdop / 100 > HDOP else ()


def estimator_doubts(flags: int, *, message_id: int) -> tuple[str, ...]:
    """What the estimator's flags say against the position.

    Args:
        flags: of EKF_STATUS_REPORT or ESTIMATOR_STATUS.
        message_id: 193 or 230.
    """
    if flags & _CONSTANT_POSITION:
        return ("the estimator holds a constant position",)
    if not flags & _POSITION_ABSOLUTE:
        return ("the estimator has no absolute position",)
    return ("the estimator reports a GPS glitch",) if flags & _GLITCH[message_id] else ()


class PositionHealth:
    """The newest reports about the position.

    A receiver that never had a fix does not count: the vehicle may fly by other sensors.
    """

    def __init__(self) -> None:
        self._had_fix = False
        self._receiver: tuple[str, ...] = ()
        self._estimator: tuple[str, ...] | None = None

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the position is not to be trusted; empty if nothing is reported."""
        return (self._receiver if self._had_fix else ()) + (self._estimator or ())

    @property
    def estimator_ok(self) -> bool | None:
        """Whether the estimator has an absolute position; None if it does not say."""
        return None if self._estimator is None else not any("position" in doubt for doubt in self._estimator)

    def receiver(self, fields: Mapping[str, Any]) -> None:
        """Take GPS_RAW_INT (24)."""
        self._receiver = receiver_doubts(fields)
        self._had_fix |= not self._receiver

    def estimator(self, flags: int, *, message_id: int) -> None:
        """Take the flags of EKF_STATUS_REPORT (193) or ESTIMATOR_STATUS (230)."""
        self._estimator = estimator_doubts(flags, message_id=message_id)

    def forget(self) -> None:
        """The autopilot rebooted, or the link was lost."""
        self._receiver, self._estimator = (), None
