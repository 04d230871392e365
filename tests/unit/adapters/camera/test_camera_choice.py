"""The camera that takes photos is chosen, whichever answers first."""

from __future__ import annotations

import itertools

import pytest

from panoexec.adapters.camera.camera_choice import CameraCandidate, choose, why_none

STREAMER = CameraCandidate(component=100, vendor="streamer", model="rtsp0", image_width_px=1920, flags=256)
RECORDER = CameraCandidate(component=102, model="recorder", flags=1 | 4)
EYE = CameraCandidate(component=101, vendor="ACME", model="Eye", image_width_px=5280, image_height_px=3956, flags=2 | 4)
THERMAL = CameraCandidate(component=100, model="thermal", image_width_px=640, image_height_px=512, flags=2)
SHUTTER = CameraCandidate(component=1)
MUTE = CameraCandidate(component=103)


@pytest.mark.parametrize("order", list(itertools.permutations([STREAMER, EYE, SHUTTER, RECORDER, MUTE])))
def test_only_what_says_that_it_takes_photos_is_taken(order: tuple[CameraCandidate, ...]) -> None:
    choice = choose(order)
    assert choice is not None
    assert (choice.camera, choice.reason) == (EYE, "the only camera that takes photos")


def test_a_shutter_of_the_autopilot_still_works() -> None:
    for flags in (0, 2, 3):
        shutter = CameraCandidate(component=1, flags=flags)
        choice = choose([STREAMER, shutter])
        assert choice is not None
        assert (choice.camera, choice.reason) == (shutter, "no other camera takes photos")
    assert choose([CameraCandidate(component=1, flags=256)]) is None


def test_of_several_the_one_of_the_profile_is_taken() -> None:
    choice = choose([THERMAL, EYE], image_px=(3956, 5280))
    assert choice is not None
    assert (choice.camera, choice.reason) == (EYE, "the only camera with the image size of the profile")
    lowest = choose([EYE, THERMAL], image_px=(4000, 3000))
    assert lowest is not None
    assert (lowest.camera, lowest.reason) == (THERMAL, "the lowest component of those that take photos")


def test_a_key_chooses_but_makes_no_camera_of_a_streamer() -> None:
    choice = choose([THERMAL, EYE], component=101)
    assert choice is not None
    assert (choice.camera, choice.reason) == (EYE, "[camera] component")
    mute = choose([MUTE, EYE], component=103)  # it tells nothing of itself: the operator knows it
    assert mute is not None
    assert mute.camera is MUTE
    assert choose([STREAMER, EYE], component=100) is None
    why = why_none([STREAMER, EYE], component=100)
    assert why == (
        "component 100 is configured, but takes no photos (streamer rtsp0, component 100: video stream); "
        "ACME Eye, component 101 does"
    )


def test_why_there_is_none() -> None:
    assert why_none([STREAMER], component=0) == (
        "component 100 takes no photos (streamer rtsp0, component 100: video stream)"
    )
    assert why_none([], component=0) == ""
    assert why_none([EYE], component=105) == ""
    assert MUTE.summary == "unnamed, component 103: nothing that it tells"
    assert SHUTTER.summary == "a shutter of the autopilot, component 1: photos"
