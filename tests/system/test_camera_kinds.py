"""What a mission on each kind of simulated camera may cost, and of what it warns; nothing accepted is untrue.

`PANOEXEC_ALL_FAULTS=1` flies one mission for every kind and its variants instead of a few.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("pymavlink")

from panoexec.sim.camera_kinds import CAMERA_KINDS
from tests.support.truth import read_truth
from tests.system.kind_missions import REFUSED_CAMERAS, SHOTS, Payload, fly

EXPECTED = {
    # kind, changes: rejections at most, warnings
    ("mavlink",): (0, ()),
    ("servo",): (0, ()),
    ("late",): (2, ("latency",)),
    ("late", "camera.latency_s=2.4"): (2, ("latency",)),
    ("late-and-irregular",): (6, ("latency",)),
    ("late-and-irregular", "camera.latency_jitter_s=0.6"): (6, ("latency",)),
    ("deferred",): (0, ("interval",)),
    ("deferred", "camera.trigger_min_s=4"): (0, ("interval",)),
    ("deferred-failed",): (0, ("interval",)),
    ("deferred-failed", "camera.trigger_min_s=1.6"): (0, ("interval",)),
    ("deferred-untold",): (0, ("interval",)),
    ("deferred-untold", "camera.trigger_min_s=4"): (0, ("interval",)),
    ("queue",): (4, ("latency",)),
    ("queue", "camera.interval_s=4", "camera.queue=1"): (8, ()),
    ("slow",): (8, ("interval",)),
    ("slow", "camera.interval_s=4"): (9, ("interval",)),
    ("video-mode",): (0, ()),
    ("streamer",): (0, ()),
    ("streamer", "camera.latency_s=0.5"): (2, ("latency",)),
    ("two-cameras",): (0, ()),
    ("two-cameras", "camera.starts_in_video=true"): (0, ()),
    ("px4-trigger",): (0, ()),
    ("px4-trigger", "camera.exposure_s=0.005"): (0, ()),
    ("silent-third",): (4, ()),
    ("silent-third", "camera.silent_every=2"): (8, ()),
    ("index-reset",): (2, ()),
    ("index-reset", "camera.reset_after=1"): (2, ()),
    ("undated",): (2, ()),
    ("undated", "camera.latency_s=1"): (2, ()),
}
"""What a mission on each kind, and on a variant of it, may cost; photos that are late once are taken again."""
SHORT = (("silent-third",),)
"""What the suite flies; PANOEXEC_ALL_FAULTS=1 flies all."""
ALL = "PANOEXEC_ALL_FAULTS" in os.environ


@pytest.mark.parametrize("case", EXPECTED if ALL else SHORT, ids=" ".join)
async def test_a_mission_on_each_kind_accepts_nothing_untrue(tmp_path: Path, case: tuple[str, ...]) -> None:
    kind, *changes = case
    flown = await fly(tmp_path, Payload(camera=kind, changes=tuple(changes)))
    assert flown.untrue == []
    assert (flown.summary.state, flown.summary.missing) == ("complete", ())
    most, codes = EXPECTED[case]
    assert sum(flown.summary.rejected.values()) <= most, flown.summary.rejected
    for code in codes:
        assert len(flown.warned(code)) >= 1
    if "deferred" in kind:  # each trigger took its photo, whose pose was held until then
        exposures = read_truth(flown.summary.directory / "images" / "truth.jsonl")
        assert len(exposures) == flown.summary.attempts == SHOTS


async def test_a_camera_that_stays_in_video_mode_fails_the_preflight(tmp_path: Path) -> None:
    summary = (await fly(tmp_path, Payload(camera="video-locked"))).summary
    assert summary.state == "failed"
    assert "the camera is in video mode and stays there: changing its mode (530): denied" in summary.reason
    assert summary.attempts == 0


def test_every_kind_is_flown() -> None:
    assert {case[0] for case in EXPECTED} | REFUSED_CAMERAS == set(CAMERA_KINDS)
