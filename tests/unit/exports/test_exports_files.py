from __future__ import annotations

import csv
import io
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from panoexec.angles import quaternion_from_rotation, rotation, rotation_321, rotation_from_quaternion, wrap_180
from panoexec.errors import UsageError
from panoexec.exports import (
    FORMATS,
    ExportSet,
    ExportShot,
    check_format,
    export_plan,
    from_plan,
    local_name,
    write_exports,
)
from panoexec.exports.hugin import hugin_project
from panoexec.exports.papywizard import papywizard_angles, papywizard_text
from panoexec.exports.qgc_plan import qgc_text
from panoexec.exports.shots_csv import COLUMNS, csv_text
from panoexec.exports.xmp_files import sidecar_text
from panoexec.formats.hugin_pto import parse_pto
from panoexec.optics import Camera
from panoexec.planning.geometry.pose_error import pose_error
from panoexec.planning.model import Band, Constraints, Plan, Shot

CAMERA = Camera(
    name="test",
    sensor_width_mm=17.3,
    sensor_height_mm=13.0,
    image_width_px=5280,
    image_height_px=3956,
    focal_length_mm=15.0,
)
PLAN = Plan(
    method="foreign",
    camera=CAMERA,
    constraints=Constraints(overlap_h=0.15, overlap_v=0.15, band=Band(elevation_min_deg=-90, elevation_max_deg=0)),
    shots=tuple(
        Shot(index=i, row=r, pitch_deg=p, yaw_deg=y)
        for i, (r, p, y) in enumerate([(0, -90.0, 20.0), (1, -50.0, -60.0), (1, -50.0, 60.0)])
    ),
)


def shot(yaw: float, pitch: float, roll: float = 0.0, **changes: object) -> ExportShot:
    w, x, y, z = quaternion_from_rotation(rotation(yaw, pitch, roll)).tolist()
    values: dict[str, object] = {
        "index": 0,
        "row": 0,
        "q_wxyz": (w, x, y, z),
        "target_pitch_deg": pitch,
        "target_yaw_deg": yaw,
    }
    return ExportShot(**{**values, **changes})  # type: ignore[arg-type]


def exports(*shots: ExportShot, **changes: object) -> ExportSet:
    values: dict[str, object] = {"title": "t", "camera": CAMERA, "shots": shots}
    return ExportSet(**{**values, **changes})  # type: ignore[arg-type]


# --- hugin


def test_a_plan_becomes_a_project_with_planned_angles_and_placeholders(tmp_path: Path) -> None:
    export_plan("pto", PLAN, tmp_path / "plan.pto")
    project = parse_pto((tmp_path / "plan.pto").read_text())
    assert [i.file_name for i in project.images] == ["shot_0000.jpg", "shot_0001.jpg", "shot_0002.jpg"]
    assert [(i.yaw_deg, i.pitch_deg, i.roll_deg) for i in project.images] == [
        (pytest.approx(20), -90, pytest.approx(0)),
        (-60, -50, 0),
        (60, -50, 0),
    ]
    assert project.hfov_deg == pytest.approx(CAMERA.hfov_deg)
    width = CAMERA.panorama_px()[0]
    assert project.canvas_px[0] in (width, width + 1)
    assert project.canvas_px[0] == 2 * project.canvas_px[1]


def test_small_files_make_a_small_canvas_and_one_seen_size_stands_for_all() -> None:
    project = hugin_project(exports(shot(0, 0), shot(10, 0, width_px=528, height_px=396)))
    assert {(i.width_px, i.height_px) for i in project.images} == {(528, 396)}
    assert project.canvas_px[0] == pytest.approx(CAMERA.panorama_px()[0] / 10, abs=2)


def test_a_portrait_camera_that_stores_landscape_pixels() -> None:
    portrait = CAMERA.rotated()
    told = hugin_project(exports(shot(0, 0, width_px=528, height_px=396, orientation=8), camera=portrait))
    assert told.images[0].roll_deg == -90
    assert told.hfov_deg == pytest.approx(CAMERA.hfov_deg)
    untold = hugin_project(exports(shot(0, 0, width_px=528, height_px=396), camera=portrait))
    assert untold.images[0].roll_deg == 90
    upright = hugin_project(exports(shot(0, 0, width_px=396, height_px=528), camera=portrait))
    assert upright.images[0].roll_deg == 0
    assert upright.hfov_deg == pytest.approx(CAMERA.vfov_deg)


def test_no_images_no_project() -> None:
    with pytest.raises(UsageError, match="at least one image"):
        FORMATS["pto"](exports())
    with pytest.raises(UsageError, match="cannot be written"):
        FORMATS["pto"](exports(shot(0, 0, file_name='a"b.jpg')))


# --- papywizard


@given(yaw=st.floats(-179, 179), pitch=st.floats(-90, 45), roll=st.floats(-0.5, 0.5))
@example(yaw=30, pitch=-90, roll=0.3)
@example(yaw=30, pitch=-90.01, roll=0.0)
def test_papywizard_angles_are_the_attitude_up_to_the_gimbals_roll(yaw: float, pitch: float, roll: float) -> None:
    made = shot(yaw, pitch, roll)
    y, p, r = papywizard_angles(made)
    error = pose_error(pitch, yaw, rotation_321(y, p, r))
    if abs(pitch) > 80:
        assert r == 0
        assert abs(float(wrap_180(y - yaw))) < 1e-6
        assert float(error.boresight_deg) <= 0.011
    else:
        np.testing.assert_allclose(rotation_321(y, p, r), made.rotation, atol=1e-9)
        assert abs(r) < 4


@given(yaw=st.floats(-179, 179), pitch=st.floats(80.1, 90.4), roll=st.floats(-0.5, 0.5), north=st.floats(0, 359))
@example(yaw=30, pitch=90, roll=0.3, north=0)
@example(yaw=-170, pitch=89.8, roll=-0.3, north=200)
def test_near_the_poles_sidecars_have_the_gimbals_yaw_and_no_roll(
    yaw: float, pitch: float, roll: float, north: float
) -> None:
    for sign in (-1, 1):
        made = shot(yaw, sign * pitch, roll)
        text = sidecar_text(exports(made, reference_yaw_north_deg=north), made)
        found = [float(value) for value in re.findall(r'drone-dji:Gimbal(?:Yaw|Pitch|Roll)Degree="([^"]+)"', text)]
        papywizard_yaw, papywizard_pitch, _ = papywizard_angles(made)
        # in the order of the file: yaw, pitch, roll
        assert abs(float(wrap_180(found[0] - north - papywizard_yaw))) < 2e-3
        assert found[1] == pytest.approx(papywizard_pitch, abs=1e-3)
        assert found[2] == 0


def test_papywizard_lists_pictures_in_order_and_says_what_lens() -> None:
    stamp = 1790000000.0
    made = exports(
        shot(10, -40, time_utc_s=stamp, latitude_deg=47.5, longitude_deg=8.25),
        shot(20, -90, 0.3, time_utc_s=stamp + 65),
    )
    root = ET.fromstring(papywizard_text(made).encode())
    assert root.tag == "papywizard"
    assert root.get("version") == "c"
    assert root.findtext("header/general/gps") == "47.5000000, 8.2500000"
    assert root.findtext("header/shooting/startTime") == "2026-09-21_14h13m20s"
    assert root.findtext("header/shooting/endTime") == "2026-09-21_14h14m25s"
    assert root.findtext("header/shooting/cameraOrientation") == "landscape"
    assert root.findtext("header/lens/focal") == "15"
    sensor = root.find("header/camera/sensor")
    assert sensor is not None
    assert float(sensor.get("coef", "")) == pytest.approx(2.0, abs=0.01)
    assert sensor.get("ratio") == "4:3"
    pictures = root.findall("shoot/pict")
    assert [p.get("id") for p in pictures] == ["1", "2"]
    positions = [p.find("position") for p in pictures]
    assert [dict(p.attrib) for p in positions if p is not None] == [
        {"yaw": "10.000", "pitch": "-40.000", "roll": "0.000"},
        {"yaw": "20.000", "pitch": "-90.000", "roll": "0.000"},
    ]


# --- csv


def test_the_table_has_target_measured_and_errors() -> None:
    made = exports(
        shot(
            170,
            -40,
            0.25,
            file_name="images/a,b.JPG",
            measured=True,
            time_utc_s=1790000000.5,
            target_yaw_deg=169.5,
            errors_deg={"yaw": 0.5, "pitch": -0.01, "roll": 0.25},
            attempt=2,
            evidence="FILE_SEEN",
        ),
        reference_yaw_north_deg=20.0,
    )
    (row,) = csv.DictReader(io.StringIO(csv_text(made)))
    assert tuple(row) == COLUMNS
    assert row["file"] == "images/a,b.JPG"
    assert row["time_utc"] == "2026-09-21T14:13:20.500Z"
    assert float(row["yaw_north_deg"]) == -170.0
    assert float(row["roll_deg"]) == pytest.approx(0.25)
    assert float(row["error_yaw_deg"]) == 0.5
    assert (row["attempt"], row["evidence"], row["measured"]) == ("2", "FILE_SEEN", "yes")
    q = [float(row[f"q_{axis}"]) for axis in "wxyz"]
    np.testing.assert_allclose(rotation_from_quaternion(q), rotation(170, -40, 0.25), atol=1e-8)
    hugin = rotation_321(*(float(row[f"hugin_{axis}_deg"]) for axis in "ypr"))
    np.testing.assert_allclose(hugin, rotation(170, -40, 0.25), atol=5e-6)


def test_a_plan_s_table_leaves_the_unknown_empty() -> None:
    rows = list(csv.DictReader(io.StringIO(csv_text(from_plan(PLAN)))))
    assert [row["target_yaw_deg"] for row in rows] == ["20.0000", "-60.0000", "60.0000"]
    for row in rows:
        assert row["file"] == row["time_utc"] == row["attempt"] == row["error_yaw_deg"] == row["latitude_deg"] == ""


# --- QGroundControl


def test_the_mission_points_and_shoots_each_pose_between_take_off_and_return() -> None:
    document = json.loads(qgc_text(replace(from_plan(PLAN), reference_yaw_north_deg=-170.0)))
    assert (document["fileType"], document["version"], document["mission"]["version"]) == ("Plan", 1, 2)
    items = document["mission"]["items"]
    assert [item["doJumpId"] for item in items] == list(range(1, len(items) + 1))
    assert [items[0]["command"], items[-1]["command"]] == [22, 20]
    gimbal = [item["params"] for item in items if item["command"] == 1000]
    # yaw from north; roll, pitch and yaw locked to the earth
    assert [(p[0], p[1], p[4]) for p in gimbal] == [(-90.0, -150.0, 28), (-50.0, 130.0, 28), (-50.0, -110.0, 28)]
    assert [item["params"][3] for item in items if item["command"] == 2000] == [1, 2, 3]
    assert all(len(item["params"]) == 7 and item["type"] == "SimpleItem" for item in items)
    # after each pose comes a wait, then the photo
    commands = [item["command"] for item in items[1:-1]]
    assert commands == [1000, 93, 2000, 93] * 3


# --- whole missions


def test_a_mission_directory_gets_all_files_and_sidecars_beside_the_photos(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "DJI_0001.JPG").write_bytes(b"")
    made = exports(
        shot(10, -90, file_name="images/DJI_0001.JPG", measured=True, latitude_deg=47.5, longitude_deg=8.25),
        shot(20, -40, file_name="DJI_0002.JPG", index=1, measured=True),
        reference_yaw_north_deg=90.0,
    )
    written = write_exports(made, tmp_path)
    names = sorted(str(path.relative_to(tmp_path)) for path in written)
    assert names == [
        "geo.txt",
        "images/DJI_0001.xmp",
        "panorama.pto",
        "panorama.xmp",
        "papywizard.xml",
        "shots.csv",
        "xmp/DJI_0002.xmp",
    ]
    sidecar = (tmp_path / "images" / "DJI_0001.xmp").read_text()
    # yaw from true north, not from the plan's reference
    assert 'Camera:Yaw="100.000"' in sidecar
    assert 'drone-dji:GpsLatitude="47.50000000"' in sidecar
    panorama = (tmp_path / "panorama.xmp").read_text()
    assert 'GPano:PoseHeadingDegrees="90.000"' in panorama
    assert f'GPano:FullPanoWidthPixels="{parse_pto((tmp_path / "panorama.pto").read_text()).canvas_px[0]}"' in panorama
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_a_mission_without_photos_leaves_an_empty_table_only(tmp_path: Path) -> None:
    assert write_exports(exports(), tmp_path) == [tmp_path / "shots.csv"]
    assert (tmp_path / "shots.csv").read_text().count("\n") == 1


@pytest.mark.parametrize("name", list(FORMATS))
def test_every_format_of_a_plan_is_written_whole(tmp_path: Path, name: str) -> None:
    export_plan(name, PLAN, tmp_path / "out")
    assert (tmp_path / "out").stat().st_size > 100
    with pytest.raises(UsageError, match="cannot be written"):
        export_plan(name, PLAN, tmp_path / "gone" / "out")


def test_unknown_formats_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown format; accepted are pto, papywizard, csv, qgc"):
        export_plan("ptgui", PLAN, tmp_path / "x")
    check_format("csv")


def test_local_names(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "DJI_0001.JPG").touch()
    (tmp_path / "a b.jpg").touch()
    assert local_name(tmp_path, "/DCIM/100MEDIA/DJI_0001.JPG") == "images/DJI_0001.JPG"
    assert local_name(tmp_path, r"C:\DCIM\DJI_0001.JPG") == "images/DJI_0001.JPG"
    assert local_name(tmp_path, "images/DJI_0001.JPG") == "images/DJI_0001.JPG"
    assert local_name(tmp_path, str(tmp_path / "images" / "DJI_0001.JPG")) == "images/DJI_0001.JPG"
    assert local_name(tmp_path, "http://10.0.0.1/v1/a%20b.jpg?x=1") == "a b.jpg"
    assert local_name(tmp_path, "../../etc/passwd") == "passwd"
    assert local_name(tmp_path, "DJI_0009.JPG") == "DJI_0009.JPG"
    assert local_name(tmp_path, "") == ""


def test_planned_shots_are_not_called_measured() -> None:
    made = from_plan(PLAN)
    assert not any(s.measured for s in made.shots)
    assert all(math.isnan(s.time_utc_s) for s in made.shots)
    np.testing.assert_allclose(made.rotations(), PLAN.rotations(), atol=1e-12)
