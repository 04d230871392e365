"""`import panoexec`: plans, certificates and mission directories for Python programs, and what an import costs."""

from __future__ import annotations

import ast
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import panoexec
from panoexec.cli.app import run
from panoexec.inputs.plan_file import plan_to_data
from tests.repository import ROOT

RECORDED = ROOT / "tests" / "data" / "recorded"
TWO_AXES = panoexec.GimbalLimits(yaw_min_deg=0, yaw_max_deg=0, yaw_endless=False, turning=panoexec.Turning())
OF_A_VEHICLE = {"mavsdk", "aiomqtt", "pymavlink", "serial", "rich", "PIL", "matplotlib"}


@pytest.fixture(scope="module")
def sector() -> panoexec.Plan:
    return panoexec.plan("dji-x5s-15mm", elevation_deg=(-20, 20), azimuth_deg=(0, 120))


@pytest.fixture
def mission_path(tmp_path: Path) -> Path:
    path = tmp_path / "missions" / "20261130T063803.046Z"
    shutil.copytree(RECORDED, path)
    (path / "images").mkdir()
    (path / "images" / "IMG_00001.jpg").write_bytes(b"photo")
    return path


def loaded_after(code: str) -> set[str]:
    """The top-level packages that a fresh interpreter has imported after some code."""
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print(*sys.modules)"], capture_output=True, text=True, check=True
    )
    return {name.split(".")[0] for name in done.stdout.split()} | set(done.stdout.split())


def test_import_loads_nothing_but_itself() -> None:
    loaded = loaded_after("import panoexec; panoexec.PanoexecError")
    assert not loaded & (OF_A_VEHICLE | {"numpy", "pydantic", "structlog", "asyncio"})
    assert {name for name in loaded if name.startswith("panoexec.")} == {"panoexec.errors"}


def test_planning_and_reading_load_no_vehicle_and_no_broker() -> None:
    loaded = loaded_after(
        "import panoexec\n"
        "p = panoexec.plan('dji-x5s-15mm', elevation_deg=(-20, 20), azimuth_deg=(0, 120)); panoexec.verify(p)\n"
        f"panoexec.open_mission({str(RECORDED)!r}).plan()"
    )
    assert "numpy" in loaded
    assert not loaded & OF_A_VEHICLE


def test_every_public_name_is_there_and_documented() -> None:
    for name in panoexec.__all__:
        value = getattr(panoexec, name)
        assert name == "__version__" or value.__doc__, name
        assert name in dir(panoexec)
    with pytest.raises(AttributeError, match="fly"):
        panoexec.fly  # type: ignore[attr-defined]  # noqa: B018


def test_the_names_for_type_checkers_are_those_at_run_time() -> None:
    """The imports under TYPE_CHECKING and the table of lazy imports say the same."""
    tree = ast.parse((ROOT / "panoexec" / "__init__.py").read_text(encoding="utf-8"))
    imports = [node for block in tree.body if isinstance(block, ast.If) for node in block.body]
    typed = {alias.name: node.module for node in imports if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert typed == panoexec._MODULE_OF
    assert {*typed, "__version__"} == set(panoexec.__all__)


@pytest.mark.parametrize(
    ("options", "arguments"),
    [
        ([], {}),
        (["--yaw", "vehicle"], {"gimbal": TWO_AXES}),
        (
            [
                *("--overlap-h", "0.3", "--elevation", "-40", "10", "--azimuth", "0", "90", "--tolerance-yaw", "1"),
                *("--guarantee", "all", "--order", "rows", "--mask", "-40", "-30", "0", "20"),
                *("--gimbal-pitch", "-60", "40"),
            ],
            {
                "overlap_h": 0.3,
                "elevation_deg": (-40, 10),
                "azimuth_deg": (0, 90),
                "tolerance_deg": {"yaw": 1.0},
                "guarantee": "all",
                "order": "rows",
                "masks": [(-40, -30, 0, 20)],
                "gimbal": panoexec.GimbalLimits(pitch_min_deg=-60, pitch_max_deg=40),
            },
        ),
        (["--method", "hdrpano", "--columns", "8", "--rows", "4"], {"method": "hdrpano", "columns": 8, "rows": 4}),
    ],
)
def test_plans_are_those_of_the_command_line(
    options: list[str], arguments: dict[str, object], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["plan", "--camera", "dji-x5s-15mm", "--json", *options]) in {0, 1}
    said = json.loads(capsys.readouterr().out)
    made = panoexec.plan("dji-x5s-15mm", **arguments)  # type: ignore[arg-type]
    assert json.loads(json.dumps(plan_to_data(made))) == said


def test_save_and_load(sector: panoexec.Plan, tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    sector.save(path)
    assert json.loads(path.read_text())["format"] == "panoexec.plan/1"
    loaded = panoexec.Plan.load(str(path))
    assert isinstance(loaded, panoexec.Plan)
    assert (loaded.shots, loaded.camera, loaded.constraints) == (sector.shots, sector.camera, sector.constraints)
    assert loaded.certificate is None  # nobody has verified what the file says
    assert panoexec.verify(path) == sector.certificate
    assert run(["verify", str(path), "--json"]) == 0


def test_verify_overrides_what_the_plan_says(sector: panoexec.Plan) -> None:
    assert panoexec.verify(sector).certified
    assert not panoexec.verify(sector, tolerance_deg={"yaw": 8.0}).certified
    assert not panoexec.verify(sector, camera="dji-x5s-45mm").certified
    assert panoexec.verify(sector, elevation_deg=(-10, 10), masks=[], overlap=0.1).certified
    fewer = replace(sector, shots=sector.shots[2:])
    assert panoexec.verify(fewer).holes


def test_foreign_and_published_plans(tmp_path: Path) -> None:
    path = tmp_path / "foreign.json"
    path.write_text(json.dumps({"shots": [{"pitch_deg": 0, "yaw_deg": yaw} for yaw in range(0, 360, 20)]}))
    with pytest.raises(panoexec.UsageError, match="names no camera: give camera="):
        panoexec.Plan.load(path)
    plan = panoexec.Plan.load(path, camera="dji-x5s-15mm")
    assert (plan.method, plan.constraints.overlap_h, plan.constraints.tolerance.yaw_deg) == ("foreign", 0.15, 0.7)
    assert panoexec.verify(path, camera=plan.camera, elevation_deg=(-15, 15)).certified
    assert not panoexec.verify("scenario-2-hdrpano").certified


def test_the_lens_that_counts() -> None:
    nominal = panoexec.plan("dji-x5s-45mm", lens="nominal", elevation_deg=(-20, 20), azimuth_deg=(170, -100))
    assert nominal.camera.focal_length_used_mm == 45.0
    judged, in_the_air = panoexec.verify(nominal), panoexec.verify(nominal, lens="calibrated")
    assert judged.certified
    assert judged.min_overlap_h is not None
    assert in_the_air.min_overlap_h is not None
    assert in_the_air.min_overlap_h < judged.min_overlap_h
    calibrated = panoexec.plan("dji-x5s-45mm", elevation_deg=(-20, 20), azimuth_deg=(170, -100))
    assert calibrated.camera.focal_length_used_mm == 46.0
    assert calibrated.constraints.band == nominal.constraints.band
    with pytest.raises(panoexec.UsageError, match="has no calibrated lens"):
        panoexec.plan("siyi-a8-mini", lens="calibrated")


def test_cameras_by_name_by_file_by_profile_and_as_such(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    shutil.copy(ROOT / "panoexec" / "profiles" / "dji-x5s-15mm.toml", file)
    camera = panoexec.Camera(
        name="mine", sensor_width_mm=17.3, sensor_height_mm=13.0, image_width_px=5280, image_height_px=3956,
        focal_length_mm=15.0, calibrated_focal_length_mm=14.87,
    )  # fmt: skip
    portrait = panoexec.load_profile("dji-x5s-15mm", orientation="portrait")
    plans = [panoexec.plan(c, elevation_deg=(-20, 20), azimuth_deg=(0, 90)) for c in (file, str(file), camera)]
    assert plans[0].shots == plans[1].shots == plans[2].shots
    assert panoexec.plan(portrait, elevation_deg=(-20, 20), azimuth_deg=(0, 90)).camera.is_portrait


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"method": "best"}, "method 'best' is not known: one of certified, paper, hdrpano"),
        ({"order": "random"}, "order 'random'"),
        ({"guarantee": "some"}, "guarantee 'some'"),
        ({"tolerance_deg": {"pan": 1.0}}, "tolerance_deg 'pan' is not known: one of pitch, roll, yaw"),
        ({"masks": [(0, 10)]}, "mask"),
        ({"elevation_deg": (0, 10, 20)}, "elevation_deg"),
        ({"overlap": 15.0}, "give a fraction"),
        ({"method": "hdrpano"}, "columns"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, object], text: str) -> None:
    with pytest.raises(panoexec.UsageError, match=text):
        panoexec.plan("dji-x5s-15mm", **arguments)  # type: ignore[arg-type]


def test_unknown_cameras_and_files() -> None:
    with pytest.raises(panoexec.UsageError, match="did you mean"):
        panoexec.plan("dji-x5s")
    with pytest.raises(panoexec.InputFileError, match=r"no\.toml: cannot be read"):
        panoexec.plan(Path("no.toml"))
    with pytest.raises(panoexec.PanoexecError, match="cannot be read"):
        panoexec.verify("no.json")


def test_a_mission_directory(mission_path: Path) -> None:
    before = {path: path.read_bytes() for path in mission_path.rglob("*") if path.is_file()}
    mission = panoexec.open_mission(mission_path)
    assert (mission.path, mission.mission_id, mission.state) == (mission_path, "20261130T063803.046Z", "complete")
    assert mission.camera == panoexec.load_profile("dji-x5s-15mm").camera
    assert mission.certificate is not None
    assert mission.certificate.certified
    assert mission.started is not None
    assert mission.finished is not None
    assert mission.finished > mission.started
    assert (len(mission.shots), mission.missing, len(mission.photos)) == (18, (), 18)
    first, second = mission.shots[:2]
    assert first.photos == (mission_path / "images" / "IMG_00001.jpg",)
    assert first.attitude is not None
    assert first.attitude.pitch_deg == pytest.approx(first.target.pitch_deg, abs=mission.tolerance.pitch_deg)
    assert [attempt.verdict for attempt in second.attempts] == ["rejected", "accepted"]
    assert second.accepted is second.attempts[1]
    assert second.attempts[0].code == "pointing"
    assert second.attempts[0].error_deg["yaw"] > mission.tolerance.yaw_deg
    assert len(mission.plan().shots) == 18
    assert mission.manifest["vehicle"]["autopilot"] == "ardupilot"
    assert {path: path.read_bytes() for path in mission_path.rglob("*") if path.is_file()} == before


def test_an_unfinished_mission(mission_path: Path) -> None:
    (mission_path / "journal.sqlite").unlink()  # it would know better
    manifest = mission_path / "manifest.json"
    data = json.loads(manifest.read_text())
    data |= {"certificate": None, "state": "paused", "reference": {"kind": "heading", "yaw_north_deg": None}}
    data["times"] |= {"finished": None}
    data["shots"][0] |= {"accepted_attempt": None, "status": "pending", "attempts": []}
    data["shots"][1]["attempts"][0] |= {"measured": None, "error_deg": None, "photos": [], "capture_time": None}
    manifest.write_text(json.dumps(data))
    mission = panoexec.open_mission(str(mission_path))
    assert (mission.certificate, mission.finished, mission.reference_yaw_north_deg) == (None, None, None)
    assert mission.missing == (0,)
    assert (mission.shots[0].attitude, mission.shots[0].photos) == (None, ())
    assert mission.shots[1].attempts[0].attitude is None


def test_what_is_no_mission(mission_path: Path, tmp_path: Path) -> None:
    with pytest.raises(panoexec.UsageError, match="no such directory"):
        panoexec.open_mission(tmp_path / "nothing")
    with pytest.raises(panoexec.UsageError, match="not a mission directory"):
        panoexec.open_mission(tmp_path)
    data = json.loads((mission_path / "manifest.json").read_text())
    del data["shots"][3]["attempts"]
    (mission_path / "manifest.json").write_text(json.dumps(data))
    with pytest.raises(panoexec.InputFileError, match="damaged or incomplete"):
        panoexec.open_mission(mission_path)
