"""`panoexec stitch` with Hugin's real tools on missions whose truth is known."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from panoexec.angles import FloatArray, angle_between
from panoexec.cli import app
from panoexec.errors import UsageError
from panoexec.exports import export_set, write_exports
from panoexec.formats.hugin_pto import parse_pto
from panoexec.sim.photos.scene import procedural_scene
from panoexec.stitching import rendering
from panoexec.stitching.canvas import Block
from panoexec.stitching.tiff import TiledTiff
from panoexec.store.manifest import read_manifest
from tests.missions import BAND, CAMERA, ring_poses, write_mission

pytestmark = pytest.mark.skipif(
    shutil.which("nona") is None or shutil.which("cpfind") is None,
    reason="Hugin's tools are not installed: apt-get install hugin-tools",
)

POSES = ring_poses([(-90.0, 1), (-35.0, 6)])
WIDTH = 420


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FloatArray]:
    folder = tmp_path_factory.mktemp("missions") / "20260921T141300.000Z"
    return folder, write_mission(folder, CAMERA, POSES, procedural_scene(1, 2048), width_px=WIDTH, band=BAND, seed=3)


@pytest.fixture(scope="module")
def stitched(flown: tuple[Path, FloatArray]) -> tuple[int, Path]:
    return app.run(["stitch", str(flown[0])]), flown[0] / "stitch"


@pytest.fixture
def copy(flown: tuple[Path, FloatArray], stitched: tuple[int, Path], tmp_path: Path) -> Path:
    """A mission that has been stitched, to be spoiled."""
    assert stitched[0] == 0
    return Path(shutil.copytree(flown[0], tmp_path / "m", copy_function=shutil.copy2))


def test_a_complete_mission_is_stitched_complete(stitched: tuple[int, Path]) -> None:
    code, work = stitched
    document = json.loads((work / "stitch.json").read_text())
    assert code == 0
    assert document["completeness"]["fraction"] == 1.0
    assert document["completeness"]["hole_px"] == 0
    assert document["images"] == len(POSES)
    assert document["untied"] == []
    assert document["rms_px"] < 1.0
    assert set(document["seconds"]) == {"match", "align", "render", "finish"}
    left = {path.name for path in work.iterdir()}
    assert {"panorama.tif", "panorama.jpg", "aligned.pto", "stitch.json"} <= left
    assert (work.parent / "report.html").exists()
    assert not left & {"blocks", "remapped", "panorama.tif.part"}


def test_the_projects_open_in_hugins_tools_without_a_warning(
    flown: tuple[Path, FloatArray], stitched: tuple[int, Path], tmp_path: Path
) -> None:
    """Read, checked, and one image remapped from each: photos are found from where the project lies."""
    for project in (flown[0] / "panorama.pto", stitched[1] / "matched.pto", stitched[1] / "aligned.pto"):
        if project.name == "panorama.pto":
            write_exports(export_set(read_manifest(flown[0] / "manifest.json"), flown[0]), flown[0])
        for command in (
            ["pto_var", "--opt=y,p,r", "-o", str(tmp_path / "set.pto"), str(project)],
            ["pano_modify", "--straighten", "-o", str(tmp_path / "modified.pto"), str(project)],
            ["nona", "-i", "0", "-o", str(tmp_path / "image"), str(project)],
        ):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            said = (done.stdout + done.stderr).lower()
            assert done.returncode == 0, said
            assert not [word for word in ("warning", "error", "unable", "fail", "cannot") if word in said], said


def test_all_images_are_connected_after_the_search_for_control_points(stitched: tuple[int, Path]) -> None:
    """`matched.pto` is what `cpfind --prealigned` made of the mission's project."""
    for name in ("matched.pto", "aligned.pto"):
        done = subprocess.run(["checkpto", str(stitched[1] / name)], capture_output=True, text=True, check=False)
        assert "All images are connected." in done.stdout, done.stdout
        assert done.returncode == 0


def test_the_images_are_where_they_were_taken(flown: tuple[Path, FloatArray], stitched: tuple[int, Path]) -> None:
    """Pointing errors of 0.667° are found to a fraction of a pixel (0.2°), up to the turn of the whole."""
    truth, found = flown[1], parse_pto((stitched[1] / "aligned.pto").read_text()).rotations()
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", truth, found))
    whole = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    left = angle_between((whole @ found)[:, :, 0], truth[:, :, 0])
    assert left.max() < 0.06
    # and the whole is off by no more than the mean of the errors
    assert np.degrees(np.arccos((np.trace(whole) - 1) / 2)) < 0.667


def test_the_panorama_is_the_scene(flown: tuple[Path, FloatArray], stitched: tuple[int, Path]) -> None:
    with PIL.Image.open(stitched[1] / "panorama.tif") as picture:
        panorama = np.asarray(picture).astype(float)
    height, width = panorama.shape[:2]
    assert width == 2 * height
    scene = procedural_scene(1, 2 * (width // 2)).pixels.astype(float)
    ground = slice(height // 2 + 20, height - 4)
    assert (panorama[ground, :, 3] == 255).all()
    # the yaw of the whole is known to the mean of the errors: a few pixels
    shifts = range(-4, 5)
    difference = [np.abs(np.roll(panorama[ground, :, :3], s, axis=1) - scene[ground]).mean() for s in shifts]
    assert min(difference) < 20
    turned = np.abs(np.roll(panorama[ground, :, :3], width // 4, axis=1) - scene[ground]).mean()
    assert turned > 2 * min(difference)


def test_the_preview_is_a_sphere_for_viewers(stitched: tuple[int, Path]) -> None:
    content = (stitched[1] / "panorama.jpg").read_bytes()
    assert b'GPano:ProjectionType="equirectangular"' in content
    assert b'GPano:PoseHeadingDegrees="30.000"' in content
    with PIL.Image.open(stitched[1] / "panorama.jpg") as picture:
        assert f'GPano:FullPanoWidthPixels="{picture.size[0]}"'.encode() in content
    assert b"GPano" in (stitched[1] / "panorama.tif").read_bytes()


def test_a_second_run_has_nothing_to_do(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (copy / "stitch" / "panorama.tif").stat().st_mtime_ns
    assert app.run(["stitch", str(copy), "--json"]) == 0
    shown = capsys.readouterr()
    document = json.loads(shown.out)
    assert document["format"] == "panoexec.stitch/1"
    assert document["completeness"]["fraction"] == 1.0
    assert (copy / "stitch" / "panorama.tif").stat().st_mtime_ns == before
    assert shown.err.count("done before") == 4


def test_an_interrupted_rendering_goes_on(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The disk is full in the middle: exit code 3 and one line; then the blocks that were done are kept."""
    calls: list[int] = []
    real = rendering.PanoramaRenderer._render_block

    def render_block(self: rendering.PanoramaRenderer, block: Block, tiff: TiledTiff) -> None:
        calls.append(len(calls))
        if len(calls) == 3:
            raise OSError(28, "No space left on device")
        real(self, block, tiff)

    monkeypatch.setattr(rendering.PanoramaRenderer, "_render_block", render_block)
    # small blocks on another canvas: points and alignment stay, rendering starts anew
    arguments = ["stitch", str(copy), "--width", "1400", "--memory", "128"]
    monkeypatch.setattr("panoexec.stitching.rendering.block_side", lambda *_: 512)
    assert app.run(arguments) == 3
    message = capsys.readouterr().err
    assert "No space left on device" in message
    assert "completed steps are kept" in message
    assert message.count("done before") == 2
    assert app.run(arguments) == 0
    # 3 x 2 blocks: two were done, the third is tried again
    assert len(calls) == 3 + 4
    with PIL.Image.open(copy / "stitch" / "panorama.tif") as picture:
        alpha = np.asarray(picture)[..., 3]
    assert picture.size == (1400, 700)
    assert (alpha[370:] == 255).all()
    assert json.loads((copy / "stitch" / "stitch.json").read_text())["completeness"]["hole_px"] == 0


def test_a_disk_that_is_full_for_every_file_is_told_as_that(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not even the state of the steps can be written any more."""

    def full(path: Path, content: object, *, sync: bool = True) -> None:
        raise UsageError(f"{path}: cannot be written") from OSError(28, "No space left on device")

    monkeypatch.setattr("panoexec.stitching.pipeline.write_atomically", full)
    assert app.run(["stitch", str(copy), "--width", "1200"]) == 3
    message = capsys.readouterr().err.splitlines()[-1]
    assert "No space left on device" in message
    assert "completed steps are kept" in message
    monkeypatch.undo()
    assert app.run(["stitch", str(copy), "--width", "1200"]) == 0
    assert capsys.readouterr().err.count("done before") == 2


def test_missing_and_damaged_photos_are_named_and_their_holes_found(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (copy / "images" / "IMG_0005.jpg").unlink()
    path = copy / "images" / "IMG_0003.jpg"
    path.write_bytes(path.read_bytes()[:-2000])
    assert app.run(["stitch", str(copy), "--width", "1024"]) == 1
    shown = capsys.readouterr()
    assert "left out: IMG_0005.jpg is missing" in shown.err
    assert "left out: images/IMG_0003.jpg is truncated" in shown.err
    document = json.loads((copy / "stitch" / "stitch.json").read_text())
    assert document["completeness"]["fraction"] < 0.95
    assert "100.00 %" not in shown.out
    holes = document["completeness"]["holes"]
    # image 3 looked at yaw -60, image 5 at +60
    assert sorted(round(h["azimuth_deg"] / 60) for h in holes[:2]) == [-1, 1]
    assert all(h["elevation_deg"] < -10 for h in holes[:2])


def test_a_mission_without_usable_photos(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(copy / "images")
    assert app.run(["stitch", str(copy)]) == 1
    message = capsys.readouterr().err
    assert "none of the 7 accepted photos is usable" in message
    assert "copy them from the camera" in message
    document = json.loads((copy / "manifest.json").read_text())
    for shot in document["shots"]:
        shot["accepted_attempt"] = None
    (copy / "manifest.json").write_text(json.dumps(document))
    assert app.run(["stitch", str(copy)]) == 1
    assert "no accepted photo to stitch" in capsys.readouterr().err


def test_tools_that_are_not_installed_or_fail(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tools = tmp_path / "bin"
    tools.mkdir()
    monkeypatch.setenv("PATH", str(tools))
    assert app.run(["stitch", str(copy), "--restart", "--matcher", "cpfind"]) == 3
    assert "not installed (missing: nona, cpfind): install them with" in capsys.readouterr().err
    for name in ("cpfind", "nona"):
        (tools / name).write_text("#!/bin/sh\necho went wrong\nexit 7\n")
        (tools / name).chmod(0o755)
    assert app.run(["stitch", str(copy), "--restart", "--matcher", "cpfind"]) == 3
    assert "cpfind ended with code 7: went wrong" in capsys.readouterr().err
    assert app.run(["stitch", str(copy), "--restart"]) == 3
    assert "nona ended with code 7: went wrong" in capsys.readouterr().err


def _stitch_json(folder: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, dict[str, Any]]:
    capsys.readouterr()
    code = app.run(["stitch", str(folder), "--restart", "--json", *options])
    return code, json.loads(capsys.readouterr().out)


def test_all_photos_one_place_off_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "20260921T141300.000Z"
    poses = ring_poses([(-68.0, 4), (-35.0, 7), (-8.0, 6)])
    write_mission(folder, CAMERA, poses, procedural_scene(1, 2048), width_px=WIDTH, band=BAND, seed=3)
    photos = sorted((folder / "images").glob("*.jpg"))
    contents = [photo.read_bytes() for photo in photos]
    for photo, content in zip(photos, [*contents[1:], contents[0]], strict=True):
        photo.write_bytes(content)
    code, document = _stitch_json(folder, capsys)
    assert code == 1
    assert document["completeness"] is None
    assert len(document["content"]["bad"]) > len(photos) / 2
    assert not (folder / "stitch" / "panorama.tif").exists()


def test_a_black_and_a_wrong_photo_do_not_count(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos = sorted((copy / "images").glob("*.jpg"))
    with PIL.Image.open(photos[2]) as picture:
        size = picture.size
    PIL.Image.new("RGB", size).save(photos[2])
    shutil.copyfile(photos[0], photos[5])
    code, document = _stitch_json(copy, capsys)
    assert code == 1
    named = {entry["shot"]: entry["code"] for entry in document["content"]["bad"]}
    assert named == {2: "exposure", 5: "contradicts"}
    assert {entry["file"] for entry in document["content"]["bad"]} == {f"images/{photos[k].name}" for k in (2, 5)}
    assert document["completeness"]["hole_px"] > 0
    assert document["images"] == len(photos) - 2


def test_differences_of_exposure_are_evened_out(
    copy: Path, stitched: tuple[int, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    photos = sorted((copy / "images").glob("*.jpg"))
    stops = [0.0, 0.8, -0.6, 0.4, -0.8, 0.6, -0.4]
    for photo, change in zip(photos, stops, strict=True):
        with PIL.Image.open(photo) as picture:
            exif = picture.getexif()
            values = np.asarray(picture, dtype=float) / 255
        changed = 255 * np.clip(0.6 * values * 2 ** (change / 2.2), 0, 1)
        PIL.Image.fromarray(changed.astype(np.uint8)).save(photo, quality=92, exif=exif)
    code, document = _stitch_json(copy, capsys)
    assert code == 0
    told = np.log2([document["content"]["gains"][f"images/{photo.name}"] for photo in photos]).mean(axis=1)
    wanted = np.mean(stops) - np.array(stops)
    assert np.abs(told - wanted).max() < 0.1
    with PIL.Image.open(copy / "stitch" / "panorama.jpg") as one, PIL.Image.open(stitched[1] / "panorama.jpg") as other:
        ours, before = (
            np.asarray(picture.convert("L"), dtype=float)[picture.height * 6 // 10 :] for picture in (one, other)
        )
    ratio = ours[before > 20] / before[before > 20]
    assert ratio.std() / ratio.mean() < 0.08, "no patchwork: the same scene, evenly darker"


def test_hugins_matcher_is_an_option(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, document = _stitch_json(copy, capsys, "--matcher", "cpfind")
    assert code == 0
    assert document["points"] > 50
    assert document["content"]["bad"] == []


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["/nowhere/at/all"], "no such directory"),
        ([".", "--width", "12"], "256 to 1000000 px"),
        ([".", "--horizon", "steep"], "above -90 and at most 90 degrees"),
        ([".", "--memory", "1"], "128 to 1000000 MiB"),
    ],
)
def test_wrong_usage(arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert app.run(["stitch", *arguments]) == 2
    assert text in capsys.readouterr().err
