"""Settings of a camera that must not change within a panorama: found, set, read back, and put back.

libgphoto2 names settings by the widgets of its drivers, which differ between makers: here are the names of Canon,
Nikon, Sony, Fujifilm, Panasonic and plain PTP cameras. MAVLink cameras name them in their definition: CAM_… are the
common parameters of MAVLink's Camera Definition File, and CAM_SHUTTER and CAM_FOCUSMODE those of definitions for Sony's
cameras. What a camera lacks or does not let be set is a problem, never ignored.
"""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from panoexec.errors import DeviceError
from panoexec.formats.photo_settings import PhotoExif
from panoexec.inputs.vehicle_sections import LockSection

PROGRAM: Final = ("expprogram", "autoexposuremodedial", "autoexposuremode", "exposureprogram", "CAM_EXPMODE")
SHUTTER: Final = ("shutterspeed", "shutterspeed2", "CAM_SHUTTERSPD", "CAM_SHUTTER")
APERTURE: Final = ("f-number", "aperture", "CAM_APERTURE")
ISO: Final = ("iso", "CAM_ISO")
WHITE_BALANCE: Final = ("whitebalance", "CAM_WBMODE")
FOCUS: Final = ("focusmode", "autofocus", "CAM_FOCUSMODE")
FOCAL_LENGTH: Final = ("focallength",)
_MANUAL: Final = ("manual", "m", "mf", "manual focus", "manual mode", "manual exposure", "m manual", "fix focus", "off")
"""Lower case."""
_CLOSE: Final = 0.15
"""Relative distance of a value from the nearest one that the camera offers: half of a third of a stop, and rounding."""

Widgets = Mapping[str, Mapping[str, Any]]
"""Settings as the process of the camera tells them."""
Setter = Callable[[str, str], Awaitable[Mapping[str, Any]]]


@dataclass(frozen=True, slots=True)
class Change:
    """One setting to make.

    Attributes:
        what: for people.
        name: of the widget.
        value: one of its choices.
        before: what it is now.
    """

    what: str
    name: str
    value: str
    before: str


class LockError(DeviceError):
    """A setting that cannot be locked; says which, what was wanted and what the camera offers."""


def needed(lock: LockSection) -> tuple[str, ...]:
    """The settings that have to be read for a lock, by every name that they may have; and the focal length."""
    exposure = (*PROGRAM, *SHUTTER, *APERTURE, *ISO) if lock.exposure != "off" else ()
    balance = WHITE_BALANCE if lock.white_balance != "off" else ()
    return (*exposure, *balance, *(FOCUS if lock.focus != "off" else ()), *FOCAL_LENGTH)


def changes(lock: LockSection, widgets: Widgets, *, metered: PhotoExif | None = None) -> list[Change]:
    """What has to be set; the exposure program comes first, because others can be set only then.

    Args:
        lock: `[camera.lock]`.
        widgets: as the camera tells them.
        metered: for `exposure = "first"`: what the camera metered.

    Raises:
        LockError: the camera lacks a setting, or a value.
    """
    out: list[Change] = []
    if lock.focus == "manual":
        out.append(_manual("focus", FOCUS, widgets))
    if lock.white_balance != "off":
        out.append(_named("white balance", WHITE_BALANCE, widgets, (lock.white_balance,)))
    if lock.exposure == "off":
        return out
    wanted = (lock.shutter_s, lock.aperture, lock.iso)
    if lock.exposure == "first":
        if metered is None or metered.exposure_s is None:
            raise LockError('[camera.lock] exposure = "first": the metered photo does not tell its exposure (EXIF)')
        wanted = (metered.exposure_s, metered.f_number, metered.iso)
    if any(name in widgets for name in PROGRAM):
        out.append(_manual("exposure program", PROGRAM, widgets))
    shutter_s, aperture, iso = wanted
    if shutter_s is not None:
        out.append(_nearest("shutter speed", SHUTTER, widgets, shutter_s))
    if aperture is not None and (lock.exposure == "manual" or _can_be_set(APERTURE, widgets)):
        out.append(_nearest("aperture", APERTURE, widgets, aperture))
    if iso is not None:
        out.append(_nearest("ISO", ISO, widgets, iso))
    else:
        _check_fixed("ISO", "iso", ISO, widgets)
    return out


async def make(planned: Sequence[Change], set_value: Setter) -> None:
    """Make settings, and check that each was taken over.

    Raises:
        LockError: the camera kept another value.
        DeviceError: it refused, or is gone.
    """
    for change in planned:
        if change.value == change.before:
            continue
        back = await set_value(change.name, change.value)
        if str(back.get("value")) != change.value:
            kept = back.get("value", "nothing")
            raise LockError(f"the camera keeps {change.what} at {kept}; {change.value} was set ([camera.lock])")


def drifted(planned: Sequence[Change], widgets: Widgets) -> list[str]:
    """Settings that no longer are what was set, one text each."""
    return [
        f"{change.what} is {widgets[change.name]['value']}, {change.value} was set"
        for change in planned
        if change.name in widgets and str(widgets[change.name]["value"]) != change.value
    ]


def seconds_of(choice: str) -> float | None:
    """A shutter speed as drivers write it: `0.0100s`, `1/100`, `10`, `1/100s`; None for `Bulb` and such."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)(?:/(\d+(?:\.\d+)?))?\s*s?", choice.strip())
    if found is None:
        return None
    numerator, denominator = float(found[1]), float(found[2] or 1)
    return numerator / denominator if numerator and denominator else None


def _number(choice: str) -> float | None:
    """A number in a choice: `f/5.6`, `5.6`, `ISO 100`, `100`; None for `Auto`."""
    found = re.fullmatch(r"(?:f/|F|ISO )?\s*(\d+(?:\.\d+)?)", choice.strip())
    return float(found[1]) if found is not None else None


def _widget(what: str, names: Sequence[str], widgets: Widgets) -> tuple[str, Mapping[str, Any]]:
    for name in names:
        if name in widgets:
            if widgets[name]["read_only"]:
                now = widgets[name]["value"]
                raise LockError(f"{what} is {now} and cannot be set from here: set it on the camera ([camera.lock])")
            return name, widgets[name]
    raise LockError(f"this camera does not let {what} be set from here: set it on the camera ([camera.lock])")


def _check_fixed(what: str, key: str, names: Sequence[str], widgets: Widgets) -> None:
    """Refuse a setting that is left as it is and that the camera then chooses itself for each photo."""
    for name in names:
        if name in widgets and _number(str(widgets[name]["value"])) is None:
            raise LockError(f"{what} is {widgets[name]['value']}, which is no fixed value: set {key} in [camera.lock]")


def _can_be_set(names: Sequence[str], widgets: Widgets) -> bool:
    return any(name in widgets and not widgets[name]["read_only"] for name in names)


def _manual(what: str, names: Sequence[str], widgets: Widgets) -> Change:
    """The change to manual; a dial on the camera that stands there already needs none."""
    for name in names:
        if name in widgets and str(widgets[name]["value"]).lower() in _MANUAL:
            return Change(what, name, str(widgets[name]["value"]), str(widgets[name]["value"]))
    return _named(what, names, widgets, _MANUAL)


def _named(what: str, names: Sequence[str], widgets: Widgets, wanted: Sequence[str]) -> Change:
    name, widget = _widget(what, names, widgets)
    for value in wanted:
        for choice in widget["choices"]:
            if choice.lower() == value.lower():
                return Change(what, name, choice, str(widget["value"]))
    raise LockError(f"{what} {wanted[0]!r}: the camera offers {', '.join(widget['choices']) or 'no choice'}")


def _nearest(what: str, names: Sequence[str], widgets: Widgets, wanted: float) -> Change:
    name, widget = _widget(what, names, widgets)
    read = seconds_of if names is SHUTTER else _number
    values = {choice: value for choice in widget["choices"] if (value := read(choice))}
    best = min(values, key=lambda choice: abs(values[choice] - wanted), default=None)
    if best is None or abs(values[best] - wanted) > _CLOSE * wanted:
        raise LockError(f"{what} {wanted:g}: the camera offers {', '.join(widget['choices']) or 'no choice'}")
    return Change(what, name, best, str(widget["value"]))
