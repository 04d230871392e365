"""Any setting of the simulation by name (`gimbal.yaw.rate_deg_s=45`), and a whole configuration as JSON and back."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, get_args

from panoexec.errors import UsageError
from panoexec.sim.config import CameraDefinition, CameraFiles, SimConfig

if TYPE_CHECKING:
    from pydantic import TypeAdapter

_CHANGEABLE = ("gimbal", "camera", "airframe")
_ANY_SIGN = {
    "min_deg",
    "max_deg",
    "latitude_deg",
    "longitude_deg",
    "home_altitude_m",
    "heading_deg",
    "wind_from_deg",
    "clock_step_s",
    "steady_error_deg",
    "pitch_bias_deg",
    "roll_bias_deg",
    "north_off_deg",
}
_NOT_ZERO = {
    "rate_deg_s",
    "acceleration_deg_s2",
    "loop_hz",
    "heading_period_s",
    "gust_corner_hz",
    "battery_minutes",
    "render_width_px",
    "exposure_s",
    "image_mib",
    "clock_rate",
    "report_hz",
}


_CHOICES = {"camera.files": get_args(CameraFiles), "camera.definition": get_args(CameraDefinition)}


def names(config: SimConfig) -> dict[str, float | bool | str]:
    """Every number and choice that can be set, with its value in `config`."""
    return {
        f"{part}.{name}": value for part in _CHANGEABLE for name, value in _leaves(getattr(config, part), prefix="")
    }


def _leaves(value: Any, *, prefix: str) -> Iterator[tuple[str, float | bool | str]]:
    for field in dataclasses.fields(value):
        inner = getattr(value, field.name)
        if dataclasses.is_dataclass(inner):
            # the optics are a camera profile's business
            if field.name != "optics":
                yield from _leaves(inner, prefix=f"{prefix}{field.name}.")
        elif isinstance(inner, bool | int | float | str):
            yield f"{prefix}{field.name}", inner


def changed(config: SimConfig, assignments: Iterable[str]) -> SimConfig:
    """The configuration with `NAME=VALUE` assignments made.

    Raises:
        UsageError: no such name, or no such value; the message says what there is.
    """
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        known = names(config)
        if name not in known:
            raise UsageError(f"--set {assignment}: no such number; there are {', '.join(sorted(known))}")
        value = _parsed(name, text, known[name]) if equals else None
        if value is None or not _makes_sense(name, value):
            raise UsageError(
                f"--set {assignment}: accepted is {name}= and {_accepted(name, known[name])} (default {known[name]})"
            )
        config = _with(config, name.split("."), value)
    return config


def _parsed(name: str, text: str, like: float | bool | str) -> float | bool | str | None:
    if isinstance(like, str):
        return text if text in _CHOICES[name] else None
    if isinstance(like, bool):
        return {"true": True, "1": True, "false": False, "0": False}.get(text.lower())
    try:
        value = float(text)
    except ValueError:
        return None
    if not math.isfinite(value):
        return None
    return int(value) if isinstance(like, int) else value


def _makes_sense(name: str, value: float | bool | str) -> bool:
    leaf = name.rpartition(".")[2]
    if isinstance(value, bool | str) or leaf in _ANY_SIGN:
        return True
    return value > 0 if leaf in _NOT_ZERO else value >= 0


def _accepted(name: str, like: float | bool | str) -> str:
    if isinstance(like, str):
        return " or ".join(_CHOICES[name])
    if isinstance(like, bool):
        return "true or false"
    leaf = name.rpartition(".")[2]
    if leaf in _ANY_SIGN:
        return "a finite number"
    return "a number above 0" if leaf in _NOT_ZERO else "a number of at least 0"


def _with(value: Any, path: list[str], leaf: float | bool | str) -> Any:
    inner = leaf if len(path) == 1 else _with(getattr(value, path[0]), path[1:], leaf)
    return dataclasses.replace(value, **{path[0]: inner})


def to_json(config: SimConfig) -> dict[str, Any]:
    """A document that `from_json` makes the same configuration of."""
    document: dict[str, Any] = _adapter().dump_python(config, mode="json")
    return document


def from_json(document: dict[str, Any]) -> SimConfig:
    """The configuration of a document that `to_json` made."""
    config: SimConfig = _adapter().validate_python(document)
    return config


def _adapter() -> TypeAdapter[Any]:
    from panoexec.codec import adapter  # noqa: PLC0415  (pydantic: `simulate --help` does not need it)

    return adapter(SimConfig)
