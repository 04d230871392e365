"""What a mission on each kind of simulated camera may cost, and of what it warns; nothing accepted is untrue.

`PANOEXEC_ALL_FAULTS=1` flies one mission for every kind and its variants instead of a few.
"""

from __future__ import annotations

import itertools
import os
from pathlib import Path

import pytest

pytest.importorskip("pymavlink")

from panoexec.formats.photo_settings import read_settings
from panoexec.sim.camera_kinds import CAMERA_KINDS
from tests.support.truth import read_truth
from tests.system.dry_runs import accepted, flown, manifest_of
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
    ("definition",): (0, ()),
    ("definition", "camera.latency_s=0.5"): (2, ("latency",)),
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
    found = await fly(tmp_path, Payload(camera=kind, changes=tuple(changes)))
    assert found.untrue == []
    assert (found.summary.state, found.summary.missing) == ("complete", ())
    most, codes = EXPECTED[case]
    assert sum(found.summary.rejected.values()) <= most, found.summary.rejected
    for code in codes:
        assert len(found.warned(code)) >= 1
    if "deferred" in kind:  # each trigger took its photo, whose pose was held until then
        exposures = read_truth(found.summary.directory / "images" / "truth.jsonl")
        assert len(exposures) == found.summary.attempts == SHOTS


async def test_a_camera_that_stays_in_video_mode_fails_the_preflight(tmp_path: Path) -> None:
    summary = (await fly(tmp_path, Payload(camera="video-locked"))).summary
    assert summary.state == "failed"
    assert "the camera is in video mode and stays there: changing its mode (530): denied" in summary.reason
    assert summary.attempts == 0


def test_every_kind_is_flown() -> None:
    assert {case[0] for case in EXPECTED} | REFUSED_CAMERAS == set(CAMERA_KINDS)


def test_a_dry_run_locks_the_settings_of_a_camera_with_a_definition(tmp_path: Path) -> None:
    options = ("--camera", "dji-x5s-15mm", "--elevation", "-30", "20", "--azimuth", "-50", "50", "--image-width", "160")
    summary = flown(*options, "--camera-kind", "definition", "--speedup", "10", "--output", str(tmp_path))
    assert summary["limit_ratio"] >= 0.99, "the gimbal is at a shot already when shooting begins"
    manifest = manifest_of(summary)
    photos = [photo for attempt in accepted(manifest) for photo in attempt["photos"]]
    images = Path(summary["directory"]) / "images"
    exposures = {read_settings(images / photo["told"].rpartition("/")[2]) for photo in photos}
    assert len(exposures) == 1
    (settings,) = exposures
    assert settings is not None
    assert settings.white_balance == "manual"
    attempts = [attempt for shot in manifest["shots"] for attempt in shot["attempts"]]
    told = {photo["told"].rpartition("/")[2] for attempt in attempts for photo in attempt["photos"]}
    taken = sorted(path.name for path in images.glob("*.jpg"))
    before = list(itertools.takewhile(lambda name: name not in told, taken))
    assert 1 <= len(before) <= 2, "one photo to meter by, or another one if the file of the first came too late"
    # a trigger that was not answered in time may have taken its photo all the same
    unanswered = [attempt for attempt in attempts if not attempt["photos"]]
    assert told <= set(taken)
    assert len(taken) - len(before) - len(told) <= len(unanswered)
    assert manifest["warnings"] == []
