"""The quick look: photos lie where their attitudes say."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from panoexec.angles import rotation
from panoexec.planning.baselines.published import X5S_15MM
from panoexec.report.panorama import _Canvas, best_picture
from panoexec.report.source import read_source
from panoexec.sim.photos.scene import procedural_scene
from panoexec.store.directory import MissionDirectory
from tests.report_missions import photographed


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> MissionDirectory:
    return photographed(tmp_path_factory.mktemp("m") / "20260921T141300.000Z", width_px=420)


def test_the_quick_look_is_the_scene(directory: MissionDirectory) -> None:
    picture, why = best_picture(read_source(directory))
    assert picture is not None, why
    with PIL.Image.open(io.BytesIO(picture.jpeg)) as opened:
        assert opened.size == (2048, 1024)
        found = np.asarray(opened.resize((512, 256))).astype(float)
    scene = np.asarray(PIL.Image.fromarray(procedural_scene(1, 1024).pixels).resize((512, 256))).astype(float)
    ground = slice(136, 254)
    difference = np.abs(found[ground] - scene[ground]).mean()
    # half a photo's pixel on a scene of fine detail; any turn or mirror is far beyond
    assert difference < 25
    for wrong in (np.roll(found, 4, axis=1), np.roll(found, 3, axis=0), found[:, ::-1], np.roll(found, 128, axis=1)):
        assert np.abs(wrong[ground] - scene[ground]).mean() > 1.25 * difference
    # nothing was photographed far above the horizon
    assert found[:60].max() < 60


def test_a_look_that_would_take_too_long_is_given_up(directory: MissionDirectory) -> None:
    picture, why = best_picture(read_source(directory), max_cpu_s=0.0)
    # seven photos: the third tells how long they take, before half of them are done
    assert picture is None
    assert "too large" in why


def test_looking_in_a_part_of_the_canvas_cuts_nothing_off(
    directory: MissionDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = read_source(directory)
    parts, _ = best_picture(source)
    monkeypatch.setattr(_Canvas, "_window", lambda canvas, _: (np.arange(canvas._height), np.arange(canvas._width)))
    whole, _ = best_picture(source)
    assert parts is not None
    assert whole is not None
    assert parts.jpeg == whole.jpeg


class _FlatCanvas(_Canvas):
    """Whose photos are all of one colour."""

    photo = np.full((601, 801, 3), 200, dtype=np.uint8)

    def _read(self, path: Path, orientation: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
        return self.photo


def test_a_direction_that_rounds_to_a_photo_s_border_is_in_it() -> None:
    canvas = _FlatCanvas(X5S_15MM, 2048)
    random = np.random.default_rng(1)
    for yaw_deg, pitch_deg, roll_deg in random.uniform((-180, -90, -0.1), (180, 30, 0.1), (150, 3)):
        canvas.add(Path("flat"), rotation(yaw_deg, pitch_deg, roll_deg), 1)
    with PIL.Image.open(io.BytesIO(canvas.jpeg())) as opened:
        assert np.asarray(opened)[-10:].mean() == pytest.approx(200, abs=2)
