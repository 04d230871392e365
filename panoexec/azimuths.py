"""The one representation of a range of azimuths."""

from __future__ import annotations

from typing import Final

MOST_AZIMUTH_DEG: Final = 720.0
SAME_AZIMUTH_DEG: Final = 1e-9
"""Azimuths closer than this are one: more than the rounding of a sum, less than any instrument can tell."""


def azimuth_range(first_deg: float, last_deg: float) -> tuple[float, float]:
    """The one representation of a range of azimuths that runs clockwise from the first to the last.

    Ranges across ±180 (and across north) may be given in either notation: 170 to 190 and 170 to -170 are the same 20°,
    350 to 10 is the same as -10 to 10. A difference of 360, up to rounding, is the full circle.

    Args:
        first_deg: within -720 to 720.
        last_deg: likewise.

    Returns:
        The first azimuth in [-180, 180), and the last one, above it by at most 360 (by rounding; see `span_of`).

    Raises:
        ValueError: the range is empty, wider than the full circle, or not a number.
    """
    if not (abs(first_deg) <= MOST_AZIMUTH_DEG and abs(last_deg) <= MOST_AZIMUTH_DEG):
        raise ValueError(f"is {first_deg:g} to {last_deg:g}: azimuths are degrees from -720 to 720")
    span = last_deg - first_deg
    if span > 360.0 + SAME_AZIMUTH_DEG:
        raise ValueError(
            f"is {first_deg:g} to {last_deg:g}, {span:g}° wide: "
            "at most 360° (the full circle), clockwise from the first to the second"
        )
    turns = 0.0 if -180.0 <= first_deg < 180.0 else 360.0 * ((first_deg + 180.0) // 360.0)
    start = _tidy(first_deg - turns) if turns else first_deg
    if start >= 180.0:
        start -= 360.0
    if abs(span - 360.0) <= SAME_AZIMUTH_DEG:
        return start, start + 360.0
    width = span % 360.0
    if not SAME_AZIMUTH_DEG < width < 360.0 - SAME_AZIMUTH_DEG:
        raise ValueError(
            f"is {first_deg:g} to {last_deg:g}, which is empty: give the ends of a sector, clockwise (170 190, or "
            "170 -170, is a sector around the back), or 360° for the full circle"
        )
    return start, last_deg if not turns and last_deg > first_deg else _tidy(start + width)


def span_of(start_deg: float, end_deg: float) -> float:
    """Width of a range as `azimuth_range` gives it: exactly 360 for the full circle."""
    span = end_deg - start_deg
    return 360.0 if abs(span - 360.0) <= SAME_AZIMUTH_DEG else span


def _tidy(angle_deg: float) -> float:
    """Without the rounding of a whole turn added."""
    return round(angle_deg, 9)
