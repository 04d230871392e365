from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from panoexec.angles import rotation
from panoexec.formats.hugin_pto import ControlPoint, PtoProject, pto_image
from panoexec.planning.model import Tolerance
from panoexec.stitching.adjustment import Lens
from panoexec.stitching.matching import as_control_points, believable, find_points
from panoexec.stitching.tools import StitchError, ToolError, check_tools, disk_error, run_tool

SIZE = (4201, 3000)


def project(size: tuple[int, int] = SIZE) -> PtoProject:
    images = tuple(pto_image(f"{k}.jpg", *size, rotation(30.0 * k, 0.0)) for k in (0, 1))
    return PtoProject(images=images, hfov_deg=60.0, canvas_px=(20000, 10000))


def tool(folder: Path, name: str, script: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tool of that name, written in Python, alone on the PATH."""
    folder.mkdir(exist_ok=True)
    path = folder / name
    path.write_text(f"#!{sys.executable}\n{script}")
    path.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))


CPFIND = """
import sys
assert "--prealigned" in sys.argv
out, source = sys.argv[sys.argv.index("-o") + 1], sys.argv[-1]
print("i0 : Analyzing image...")
print("i0 <> i1 : Found 1 matches")
open(out, "w").write(open(source).read() + "c n0 N1 x10 y20 X500.5 Y600 t0\\n")
"""


def test_points_found_in_smaller_copies_are_told_in_stored_pixels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Copies are a third as large; pixel 10 of a copy is the middle one of pixels 30, 31, 32."""
    photo = np.zeros((SIZE[1], SIZE[0], 3), dtype=np.uint8)
    photo[60:63, 30:33] = 255
    for name in ("0.jpg", "1.jpg"):
        PIL.Image.fromarray(photo).save(tmp_path / name, quality=98)
    work = tmp_path / "work"
    work.mkdir()
    tool(tmp_path / "bin", "cpfind", CPFIND, monkeypatch)
    told: list[tuple[float, str]] = []
    found = find_points(project(), tmp_path, work, lambda fraction, text: told.append((fraction, text)))
    (point,) = found.control_points
    assert (point.x1, point.y1, point.x2, point.y2) == (31, 61, 1502.5, 1801)
    assert found.images == project().images
    with PIL.Image.open(work / "match" / "00000.jpg") as copy:
        assert copy.size == (1400, 1000)
        pixels = np.asarray(copy.convert("L")).astype(int)
    assert pixels[20, 10] > 200
    assert pixels[20, 12] < 40
    assert pixels[18, 10] < 40
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert told[-1][1] == "pair 0-1"


def test_small_photos_are_searched_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tool(tmp_path / "bin", "cpfind", CPFIND, monkeypatch)
    found = find_points(project((800, 600)), tmp_path, tmp_path, lambda *_: None)
    assert found.control_points[0].x1 == 10
    assert str(tmp_path / "0.jpg") in (tmp_path / "match.pto").read_text()
    assert found.images[0].file_name == "0.jpg"


def test_a_photo_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "0.jpg").write_bytes(b"no photo")
    with pytest.raises(StitchError, match=r"0\.jpg: cannot be read as a photo"):
        find_points(project(), tmp_path, tmp_path, lambda *_: None)


def test_a_tool_without_a_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tool(tmp_path / "bin", "cpfind", "", monkeypatch)
    with pytest.raises(ToolError, match="without a result"):
        find_points(project((800, 600)), tmp_path, tmp_path, lambda *_: None)


def test_points_that_contradict_the_gimbal_are_dropped() -> None:
    # the second image looks 30° further right: x differs by f · tan 30° where both see the middle between them
    made = project((800, 600))
    lens = Lens(width_px=800, height_px=600, focal_length_px=made.focal_length_px)
    offset = made.focal_length_px * np.tan(np.radians(15))
    good = ControlPoint(first=0, second=1, x1=399.5 + offset, y1=299.5, x2=399.5 - offset, y2=299.5)
    off = ControlPoint(first=0, second=1, x1=399.5 + offset, y1=299.5, x2=399.5 - offset + 40, y2=299.5)
    points = PtoProject(images=made.images, hfov_deg=60.0, canvas_px=made.canvas_px, control_points=(good, off))
    strict = Tolerance(pitch_deg=0.0, roll_deg=0.0, yaw_deg=0.1)
    loose = Tolerance(pitch_deg=0.0, roll_deg=0.0, yaw_deg=0.667)
    # 40 pixels are 3°: beyond 1° + 6 · 0.1°, within 1° + 6 · 0.667°
    assert as_control_points(believable(points, strict, lens)) == (good,)
    assert as_control_points(believable(points, loose, lens)) == (good, off)


def test_tools_die_with_their_caller_and_their_words_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tool(tmp_path / "bin", "nona", "import sys\nprint('one')\nprint('two')\nsys.exit(3)\n", monkeypatch)
    lines: list[str] = []
    with pytest.raises(ToolError, match=r"nona ended with code 3: one \| two") as caught:
        run_tool(["nona"], tmp_path, lines.append)
    assert lines == ["one", "two"]
    assert caught.value.exit_code == 3
    tool(tmp_path / "bin", "slow", "import time\nprint('x', flush=True)\ntime.sleep(60)\n", monkeypatch)

    def stop(_: str) -> None:
        raise KeyboardInterrupt

    # returns at once: the tool is killed, not waited for
    with pytest.raises(KeyboardInterrupt):
        run_tool(["slow"], tmp_path, stop)
    tool(tmp_path / "bin", "killed", "import os\nos.kill(os.getpid(), 9)\n", monkeypatch)
    with pytest.raises(ToolError, match="killed by signal 9: no output"):
        run_tool(["killed"], tmp_path)
    with pytest.raises(ToolError, match="cannot be started"):
        run_tool(["no-such-tool"], tmp_path)
    with pytest.raises(ToolError, match=r"missing: cpfind\)"):
        check_tools(cpfind=True)


def test_a_full_disk_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = type("usage", (), {"free": 3 << 20})
    monkeypatch.setattr("panoexec.stitching.tools.shutil.disk_usage", lambda _: usage)
    assert "only 3 MiB left on the disk" in str(disk_error(tmp_path, OSError(28, "No space left on device")))
