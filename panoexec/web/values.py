"""Values of messages that anybody may have written: each is taken only in its type, and cut to a bounded size."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

_LONGEST = 400


def number(value: object, digits: int = 4) -> float | None:
    """A finite number, rounded; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return round(float(value), digits) if math.isfinite(value) else None
    except OverflowError:
        return None


def whole(value: object, most: int = 1_000_000) -> int | None:
    """A whole number from 0 to `most`; None for anything else."""
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most else None


def text(value: object, longest: int = _LONGEST) -> str:
    """A text of bounded length without control characters; "" for anything else."""
    if not isinstance(value, str):
        return ""
    return "".join(c if c.isprintable() else " " for c in value[:longest])


def numbers(value: object, count: int, digits: int = 4) -> list[float] | None:
    """So many finite numbers; None for anything else."""
    if not isinstance(value, list) or len(value) != count:
        return None
    out = [number(one, digits) for one in value]
    return None if None in out else [one for one in out if one is not None]


def wholes(value: object, most: int = 20_000) -> list[int]:
    """The whole numbers of a list."""
    if not isinstance(value, list):
        return []
    return [one for item in value[:most] if (one := whole(item)) is not None]


def pairs(value: object) -> list[list[int]]:
    """Pairs of a flat list."""
    flat = wholes(value)
    return [flat[i : i + 2] for i in range(0, len(flat) - 1, 2)]


def table(value: object) -> Mapping[str, Any]:
    """An object; an empty one for anything else."""
    return value if isinstance(value, dict) else {}


def quaternion(pitch_deg: float, yaw_deg: float) -> list[float]:
    """The attitude `[w, x, y, z]` of a camera at this pitch and yaw with roll 0 (camera FRD to NED)."""
    p, y = math.radians(pitch_deg) / 2, math.radians(yaw_deg) / 2
    w, x = math.cos(y) * math.cos(p), -math.sin(y) * math.sin(p)
    return [round(w, 6), round(x, 6), round(math.cos(y) * math.sin(p), 6), round(math.sin(y) * math.cos(p), 6)]
