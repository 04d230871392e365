"""What a user is told of a tethered camera that cannot be used, and what the configuration accepts."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from panoexec.adapters.camera.tethered.errors import explained
from panoexec.inputs.vehicle_sections import CameraSection, LockSection


@pytest.mark.parametrize(
    ("kind", "text", "port", "parts"),
    [
        ("none", "", "", ["no camera is connected by USB", "PC Remote"]),
        ("none", "Nikon on usb:001,002", "usb:001,009", ["[camera] port usb:001,009", "found: Nikon on usb:001,002"]),
        ("several", "Nikon on usb:001,002; Sony on usb:001,003", "", ["several cameras", "[camera] port or model"]),
        ("model", "Nikon D750", "", ["[camera] model is 'ILCE'", "this camera is Nikon D750"]),
        ("claimed", "Sony on usb:001,003: Could not claim", "", ["another program holds the camera", "gvfs"]),
        ("refused", "taking a photo: its card is full", "", ["its card is full"]),
    ],
)
def test_each_problem_names_the_thing_and_what_to_do(kind: str, text: str, port: str, parts: list[str]) -> None:
    line = explained(kind, text, port=port, model="ILCE")
    assert all(part in line for part in parts), line
    assert "\n" not in line


def test_a_card_that_is_full_is_known_by_its_code() -> None:
    assert explained("refused", "taking a photo: Not enough space", port="", model="", code=-115).endswith("is full")


@pytest.mark.parametrize("port", ["usb:", "usb:001,007", "ptpip:192.168.1.2", "ptpip:camera.local:15740:15740"])
def test_ports_that_libgphoto2_has(port: str) -> None:
    assert CameraSection(trigger="gphoto2", port=port).port == port


@pytest.mark.parametrize(
    ("given", "part"),
    [
        ({"trigger": "gphoto2", "port": "/dev/video0"}, "is not a port"),
        ({"trigger": "gphoto2", "port": "ptpip:a b"}, "is not a port"),
        ({"port": "usb:"}, 'need trigger = "gphoto2"'),
        ({"model": "ILCE-6000"}, 'need trigger = "gphoto2"'),
        (
            {"trigger": "serial", "serial_port": "/dev/ttyUSB0", "lock": {"focus": "manual"}},
            r"made over the camera's link: they need trigger = \"gphoto2\", or \"mavlink\"",
        ),
        ({"trigger": "gphoto2", "lock": {"exposure": "manual"}}, "needs shutter_s"),
        ({"trigger": "gphoto2", "lock": {"exposure": "first", "iso": 100}}, 'are for exposure = "manual"'),
        ({"trigger": "gphoto2", "lock": {"shutter": 1}}, "Extra inputs"),
    ],
)
def test_a_configuration_that_makes_no_sense_is_refused(given: dict[str, object], part: str) -> None:
    with pytest.raises(ValidationError, match=part):
        CameraSection.model_validate(given)


def test_nothing_is_locked_by_default() -> None:
    assert CameraSection().lock == LockSection()
