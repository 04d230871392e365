"""A mission with each kind of gimbal: refused with its cause, or complete, and nothing that was accepted is untrue."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from panoexec.sim.gimbal_kinds import GIMBAL_KINDS
from tests.support.truth import untruths
from tests.system.dry_runs import dry_run

SMALL = ("--camera", "dji-x5s-15mm", "--elevation", "-15", "5", "--azimuth", "0", "150", "--image-width", "16")
WIDE = ("--tolerance-pitch", "1", "--tolerance-roll", "1", "--tolerance-yaw", "2")

FLOWN = {
    "mavlink": ((), 154),
    "siyi": ((*WIDE, "--fault", "drift=1.0,x4"), 1),
    "gremsy": ((), 154),
    "own-manager": ((), 154),
    "two": ((), 154),
    "ten-hertz": (("--fault", "drift=1.0,x3"), 154),
    "asked": (("--autopilot", "px4"), 154),
    "north-off": ((), 154),
}
REFUSED = {
    "echo": (("--autopilot", "px4", "--fault", "gimbal-stuck=t0+9999"), "MNT_MODE_OUT = 0"),
    "echo-untold": (("--fault", "gimbal-stuck=t0+9999"), "ms in its reports, which no gimbal can do"),
    "echo-device": ((), "ms in its reports, which no gimbal can do"),
    "servo": ((), "MNT1_TYPE = 1"),
    "stranger": (("--fault", "attitude-stop=2+300"), "the gimbal has sent no attitude"),
}


def mission(tmp_path: Path, kind: str, *arguments: str) -> tuple[dict, list[str]]:  # type: ignore[type-arg]
    """The manifest of a mission with that kind, and what of it contradicts the truth."""
    done = dry_run(*SMALL, "--gimbal-kind", kind, "--speedup", "20", "--output", str(tmp_path), *arguments)
    (folder,) = (tmp_path / "missions").iterdir()
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    assert (done.returncode == 0) == (manifest["state"] == "complete"), done.stderr
    return manifest, untruths(folder)


def test_every_kind_is_flown_or_refused() -> None:
    assert {*FLOWN, *REFUSED} == set(GIMBAL_KINDS)


@pytest.mark.parametrize("kind", FLOWN)
def test_a_gimbal_that_measures_completes_and_nothing_accepted_is_untrue(tmp_path: Path, kind: str) -> None:
    arguments, device = FLOWN[kind]
    manifest, untrue = mission(tmp_path, kind, *arguments)
    assert manifest["state"] == "complete", manifest["reason"]
    assert untrue == []
    assert manifest["gimbal"]["device"] == device
    if kind == "north-off":
        assert manifest["gimbal"]["north_off_deg"] == pytest.approx(60, abs=0.5)
        assert any("the gimbal's north is +60" in text for text in manifest["warnings"])


@pytest.mark.parametrize("kind", REFUSED)
def test_a_gimbal_that_does_not_measure_is_refused_and_nothing_accepted_is_untrue(tmp_path: Path, kind: str) -> None:
    arguments, why = REFUSED[kind]
    manifest, untrue = mission(tmp_path, kind, *arguments)
    assert manifest["state"] == "failed"
    assert why in manifest["reason"]
    assert untrue == []
    if kind != "stranger":
        assert manifest["counts"]["shots_done"] == 0


def test_defaults_are_refused_to_a_gimbal_that_cannot_hold_them(tmp_path: Path) -> None:
    manifest, _ = mission(tmp_path, "siyi")
    assert manifest["state"] == "failed"
    assert "comes to rest with a steady error of pitch +0.3" in manifest["reason"]
    assert "it cannot hold tolerance_pitch_deg = 0.1" in manifest["reason"]


def test_an_unknown_kind_lists_those_that_there_are() -> None:
    done = dry_run("--camera", "dji-x5s-15mm", "--gimbal-kind", "dji")
    assert done.returncode == 2
    assert "--gimbal-kind dji: no such kind; there are mavlink, siyi, gremsy" in done.stderr
    assert "needs --autopilot ardupilot" in dry_run("--gimbal-kind", "servo", "--autopilot", "px4", *SMALL).stderr
