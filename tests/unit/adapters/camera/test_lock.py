"""Which settings are made on a tethered camera, for the widgets of several makers."""

from __future__ import annotations

from typing import Any

import pytest

from panoexec.adapters.camera.settings.lock import Change, LockError, changes, drifted, make, seconds_of
from panoexec.formats.photo_settings import PhotoExif
from panoexec.inputs.vehicle_sections import LockSection


def widget(value: str, *choices: str, read_only: bool = False) -> dict[str, Any]:
    return {"value": value, "choices": [value, *choices], "kind": "choice", "read_only": read_only}


NIKON = {
    "expprogram": widget("P", "M", "A", "S"),
    "shutterspeed": widget("0.0100s", "0.0020s", "0.0010s", "Bulb"),
    "f-number": widget("f/5.6", "f/8"),
    "iso": widget("100", "200", "Auto"),
    "whitebalance": widget("Automatic", "Daylight"),
    "focusmode": widget("AF-S", "Manual"),
}
CANON = {
    "autoexposuremode": widget("Manual", read_only=True),
    "shutterspeed": widget("1/100", "1/500", "bulb"),
    "aperture": widget("5.6", "8"),
    "iso": widget("Auto", "100", "200"),
    "whitebalance": widget("Auto", "Daylight"),
}


def made(found: list[Change]) -> dict[str, str]:
    return {one.name: one.value for one in found}


def test_manual_values_are_the_nearest_that_the_camera_offers_and_the_program_comes_first() -> None:
    lock = LockSection(exposure="manual", shutter_s=0.0021, aperture=8, iso=200, white_balance="daylight")
    found = changes(lock, NIKON)
    assert made(found) == {
        "whitebalance": "Daylight",
        "expprogram": "M",
        "shutterspeed": "0.0020s",
        "f-number": "f/8",
        "iso": "200",
    }
    names = [one.name for one in found]
    assert names.index("expprogram") < names.index("shutterspeed")


def test_a_dial_that_stands_at_manual_already_needs_no_change() -> None:
    found = changes(LockSection(exposure="manual", shutter_s=0.002, aperture=5.6, iso=100), CANON)
    assert made(found) == {
        "autoexposuremode": "Manual",
        "shutterspeed": "1/500",
        "aperture": "5.6",
        "iso": "100",
    }
    assert found[0].value == found[0].before


def test_first_takes_what_was_metered() -> None:
    lock = LockSection(exposure="first", focus="manual")
    found = changes(lock, NIKON, metered=PhotoExif(exposure_s=0.001, f_number=5.6, iso=100))
    assert made(found) == {
        "focusmode": "Manual",
        "expprogram": "M",
        "shutterspeed": "0.0010s",
        "f-number": "f/5.6",
        "iso": "100",
    }
    with pytest.raises(LockError, match="does not tell its exposure"):
        changes(lock, NIKON, metered=PhotoExif())


@pytest.mark.parametrize(
    ("lock", "widgets", "text"),
    [
        (LockSection(white_balance="Tungsten"), NIKON, "white balance 'Tungsten': the camera offers Automatic, Dayl"),
        (LockSection(exposure="manual", shutter_s=0.004), NIKON, "shutter speed 0.004: the camera offers 0.0100s"),
        (LockSection(focus="manual"), CANON, "does not let focus be set"),
        (LockSection(exposure="manual", shutter_s=0.002, aperture=8), CANON, "ISO is Auto, which is no fixed value"),
        (
            LockSection(exposure="manual", shutter_s=0.002),
            CANON | {"autoexposuremode": widget("P", read_only=True)},
            "exposure program is P and cannot be set",
        ),
    ],
)
def test_what_a_camera_lacks_is_named(lock: LockSection, widgets: dict[str, Any], text: str) -> None:
    with pytest.raises(LockError, match=text):
        changes(lock, widgets)


def test_nothing_is_locked_unless_it_is_asked_for() -> None:
    assert changes(LockSection(), {}) == []


async def test_a_setting_that_the_camera_does_not_take_over_is_a_problem() -> None:
    async def keep(name: str, value: str) -> dict[str, Any]:
        return widget("Automatic")

    with pytest.raises(LockError, match="keeps white balance at Automatic; Daylight was set"):
        await make(changes(LockSection(white_balance="Daylight"), NIKON), keep)


def test_a_setting_that_changed_since_is_told() -> None:
    planned = changes(LockSection(white_balance="Daylight"), NIKON)
    assert drifted(planned, NIKON) == ["white balance is Automatic, Daylight was set"]
    assert drifted(planned, {"whitebalance": widget("Daylight")}) == []


@pytest.mark.parametrize(
    ("text", "seconds"), [("0.0100s", 0.01), ("1/250", 0.004), ("10", 10.0), ("1/8000s", 1 / 8000), ("Bulb", None)]
)
def test_shutter_speeds_as_drivers_write_them(text: str, seconds: float | None) -> None:
    assert seconds_of(text) == seconds
