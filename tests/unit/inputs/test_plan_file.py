import contextlib
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from panoexec.errors import InputFileError, UsageError
from panoexec.inputs.plan_file import plan_from_data, plan_to_data, read_plan_file, write_plan
from panoexec.planning.baselines.published import X5S_15MM
from panoexec.planning.model import (
    AngleBox,
    Band,
    Certificate,
    Constraints,
    Estimate,
    Hole,
    Plan,
    Shot,
    Tolerance,
)

CONSTRAINTS = Constraints(
    overlap_h=0.15,
    overlap_v=0.2,
    band=Band(elevation_min_deg=-90, elevation_max_deg=30),
    tolerance=Tolerance(pitch_deg=0.017, roll_deg=0.018, yaw_deg=0.667),
    guarantee="all",
    masks=(AngleBox(elevation_min_deg=-20, elevation_max_deg=0, azimuth_min_deg=170, azimuth_max_deg=190),),
)
CERTIFICATE = Certificate(
    certified=False,
    images=2,
    min_overlap_h=0.2,
    min_overlap_v=None,
    worst_overlap_h=0.1,
    worst_overlap_v=None,
    uncovered_fraction=0.25,
    connected=True,
    two_edge_connected=False,
    failures=("C1: …",),
    holes=(Hole(elevation_deg=1, azimuth_deg=2, size_deg=3),),
    weakest_h=(0, 1),
    bridges=((0, 1),),
)


def plan(shots: tuple[Shot, ...] | None = None) -> Plan:
    return Plan(
        method="certified",
        camera=X5S_15MM,
        constraints=CONSTRAINTS,
        shots=shots
        or (Shot(index=0, row=1, pitch_deg=10.0, yaw_deg=-170.0), Shot(index=1, row=0, pitch_deg=-90.0, yaw_deg=0.0)),
        certificate=CERTIFICATE,
        estimate=Estimate(duration_s=60.0, slew_deg=400.0, panorama_px=(28515, 14258), band_px=(28515, 9505)),
        lower_bound=2,
    )


angle = st.floats(-180, 179.999)
shots_strategy = st.lists(st.tuples(st.floats(-90, 90), angle, st.integers(0, 50)), min_size=1, max_size=30).map(
    lambda rows: tuple(Shot(index=i, row=row, pitch_deg=pitch, yaw_deg=yaw) for i, (pitch, yaw, row) in enumerate(rows))
)


@given(shots_strategy)
def test_what_is_written_is_what_is_read(shots: tuple[Shot, ...]) -> None:
    original = plan(shots)
    file = plan_from_data(json.loads(json.dumps(plan_to_data(original))), source="x")
    assert file.camera == X5S_15MM
    assert file.constraints == CONSTRAINTS
    assert file.shots == shots


def test_a_file_has_the_keys_of_the_contract(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    write_plan(path, plan())
    data = json.loads(path.read_text())
    assert data["format"] == "panoexec.plan/1"
    assert data["constraints"]["elevation_deg"] == [-90, 30]
    assert data["constraints"]["tolerance_deg"] == {"pitch": 0.017, "roll": 0.018, "yaw": 0.667}
    assert data["camera"]["hfov_deg"] == pytest.approx(59.94, abs=0.005)
    assert data["shots"][1] == {"index": 1, "row": 0, "pitch_deg": -90.0, "yaw_deg": 0.0}
    assert data["certificate"]["holes"] == [{"elevation_deg": 1, "azimuth_deg": 2, "size_deg": 3}]
    assert {"certified", "images", "min_overlap_h", "uncovered_fraction", "two_edge_connected"} <= set(
        data["certificate"]
    )
    assert data["estimate"] == {
        "duration_s": 60.0,
        "slew_deg": 400.0,
        "panorama_px": [28515, 14258],
        "band_px": [28515, 9505],
        "after_s": 0.0,
    }
    assert read_plan_file(path).plan().shots == plan().shots


def test_a_foreign_file_needs_poses_only() -> None:
    shots = [{"pitch_deg": p, "yaw_deg": y} for p, y in ((10, 190), (-90, 0), (10, 0), (-30.0004, 5), (-30, 95))]
    file = plan_from_data({"shots": shots}, source="x")
    assert [shot.row for shot in file.shots] == [2, 0, 2, 1, 1]
    assert file.shots[0].yaw_deg == -170
    assert (file.method, file.camera, file.constraints) == ("foreign", None, None)
    assert file.plan(camera=X5S_15MM, constraints=CONSTRAINTS).method == "foreign"
    with pytest.raises(UsageError, match="contains no camera"):
        file.plan()
    with pytest.raises(UsageError, match="no constraints"):
        file.plan(camera=X5S_15MM)


def broken(**changes: Any) -> dict[str, Any]:
    return plan_to_data(plan()) | changes


@pytest.mark.parametrize(
    ("data", "part"),
    [
        ([], "JSON object"),
        ({}, "shots is missing"),
        ({"shots": []}, "shots is []"),
        ({"shots": [{"pitch_deg": 0}]}, "shots[0].yaw_deg is missing"),
        ({"shots": [{"pitch_deg": "up", "yaw_deg": 0}]}, "shots[0].pitch_deg is 'up'"),
        ({"shots": [{"pitch_deg": "10", "yaw_deg": 0}]}, "shots[0].pitch_deg is '10'"),
        ({"shots": [{"pitch_deg": True, "yaw_deg": 0}]}, "shots[0].pitch_deg is True"),
        ({"shots": [{"pitch_deg": 10**400, "yaw_deg": 0}]}, "shots[0].pitch_deg is 1000"),
        ({"shots": [{"pitch_deg": 0, "yaw_deg": 0, "index": True}]}, "shots[0].index is True"),
        ({"shots": [{"pitch_deg": 0, "yaw_deg": 0, "index": 0}] * 2}, "the indices must be 0 to 1, each once"),
        ({"shots": {"pitch_deg": 0, "yaw_deg": 0}}, "shots is {"),
        ({"shots": [{"pitch_deg": float("nan"), "yaw_deg": 0}]}, "shots[0].pitch_deg is nan"),
        ({"shots": [{"pitch_deg": 0, "yaw_deg": float("inf")}]}, "shots[0].yaw_deg is inf"),
        ({"shots": [{"pitch_deg": 91, "yaw_deg": 0}]}, "less than or equal to 90"),
        ({"shots": [{"pitch_deg": 0, "yaw_deg": 1e9}]}, "shots[0].yaw_deg is 1000000000.0"),
        ({"shots": [{"pitch_deg": 0, "yaw_deg": 0, "index": 1}]}, "the indices must be 0 to 0"),
        ({"shots": [{"pitch_deg": 0, "yaw_deg": 0, "index": 0}, {"pitch_deg": 0, "yaw_deg": 0}]}, "all or none"),
        (broken(format="panoexec.plan/2"), "is not supported"),
        (broken(camera={}), "camera.sensor_width_mm is missing"),
        (broken(camera=plan_to_data(plan())["camera"] | {"hfov_deg": 50}), "hfov_deg is 50, but"),
        (broken(constraints=plan_to_data(plan())["constraints"] | {"overlap_h": 15}), "constraints.overlap_h is 15"),
        (broken(constraints=plan_to_data(plan())["constraints"] | {"elevation_deg": [30, -90]}), "reversed"),
        (broken(constraints=plan_to_data(plan())["constraints"] | {"azimuth_deg": [0, 400]}), "at most 360"),
    ],
)
def test_what_is_wrong_is_named(data: object, part: str) -> None:
    with pytest.raises(InputFileError) as caught:
        plan_from_data(data, source="plan.json")
    assert part in str(caught.value)
    assert str(caught.value).startswith("plan.json: ")


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b'{"shots": [{"pitch_deg": 0, "yaw', "not valid JSON (truncated?)"),
        (b"\xff\xfe\x00", "not UTF-8"),
        (b"[" * 100_000, "is not a plan"),
        (b'{"shots": ' + b"9" * 5000 + b"}", "is not a plan"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path: Path, content: bytes, part: str) -> None:
    path = tmp_path / "plan.json"
    path.write_bytes(content)
    with pytest.raises(InputFileError) as caught:
        read_plan_file(path)
    assert part in str(caught.value)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(InputFileError, match="cannot be read"):
            read_plan_file(path)


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=10,
)


@given(
    st.dictionaries(st.sampled_from(["format", "camera", "constraints", "shots", "method"]), json_values)
    | st.fixed_dictionaries(
        {"shots": st.lists(st.fixed_dictionaries({"pitch_deg": json_values, "yaw_deg": json_values}))}
    )
)
def test_any_json_is_a_plan_or_a_clear_refusal(data: dict[str, Any]) -> None:
    with contextlib.suppress(InputFileError):
        file = plan_from_data(data, source="plan.json")
        assert all(-90 <= shot.pitch_deg <= 90 and -180 <= shot.yaw_deg < 180 for shot in file.shots)


def test_a_plan_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be written"):
        write_plan(tmp_path / "missing" / "plan.json", plan())
    assert list(tmp_path.iterdir()) == []
