"""`plan`, `verify` and `cameras` as users call them."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from panoexec.cli.app import run
from panoexec.inputs.plan_file import read_plan_file, write_plan
from panoexec.planning.baselines.published import published_plan
from panoexec.planning.model import Plan
from tests.repository import ROOT

PLAN = ["plan", "--camera", "dji-x5s-15mm", "--method", "paper"]
WATCHING = (
    "import panoexec.cli.watch; from panoexec.cli.watch_view import Watched, mission_view;"
    "one = Watched(); one.hear('plan', {'shots': [{'pitch_deg': 0, 'yaw_deg': 0}]}); mission_view('kite', one)"
)
"""Without a terminal a plan is not read, which needs numpy: it would double the processor time of `watch`."""
EXACT = ["--tolerance-pitch", "0", "--tolerance-roll", "0", "--tolerance-yaw", "0"]


class TestPlan:
    def test_json_is_the_plan_file(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        path = tmp_path / "plan.json"
        assert run([*PLAN, "--json", "--output", str(path)]) == 1  # not certified: the method leaves errors out
        out, err = capsys.readouterr()
        document = json.loads(out)
        assert document == json.loads(path.read_text())
        assert str(path) in err
        assert document["format"] == "panoexec.plan/1"
        assert document["constraints"]["tolerance_deg"] == {"pitch": 0.1, "roll": 0.1, "yaw": 0.7}
        assert document["constraints"]["elevation_deg"] == [-90, 30]
        assert (document["constraints"]["overlap_h"], document["constraints"]["overlap_v"]) == (0.15, 0.15)
        assert document["certificate"]["certified"] is False
        assert document["certificate"]["images"] == len(document["shots"]) == 19
        assert document["estimate"]["panorama_px"] == [28515, 14258]
        assert [shot["index"] for shot in document["shots"]] == list(range(19))
        assert len(read_plan_file(path).shots) == 19

    def test_the_table_says_what_matters(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert run([*PLAN, *EXACT, "--distance", "290"]) == 1
        out = capsys.readouterr().out
        for part in (
            "19 images of dji-x5s-15mm (60.37° × 47.22°, landscape)",
            "-72.06",
            "NOT CERTIFIED",
            "C3:",
            "proven",
            "28515 × 14258 px",
            "6.4 cm at 290 m",
            "duration",
        ):
            assert part in out

    def test_options_reach_the_planner(self, capsys: pytest.CaptureFixture[str]) -> None:
        argv = [*PLAN, "--overlap", "0.3", "--overlap-v", "0.2", "--elevation", "-40", "20", "--azimuth", "170", "260"]
        argv += ["--orientation", "portrait", "--tolerance-yaw", "0.4", "--guarantee", "all", "--json"]
        argv += ["--mask", "-40", "-30", "180", "190"]
        run(argv)
        document = json.loads(capsys.readouterr().out)
        constraints = document["constraints"]
        assert (constraints["overlap_h"], constraints["overlap_v"]) == (0.3, 0.2)
        assert constraints["elevation_deg"] == [-40, 20]
        assert constraints["azimuth_deg"] == [170, 260]
        assert constraints["tolerance_deg"] == {"pitch": 0.1, "roll": 0.1, "yaw": 0.4}
        assert constraints["guarantee"] == "all"
        assert constraints["masks"] == [{"elevation_deg": [-40, -30], "azimuth_deg": [-180, -170]}]
        assert document["camera"]["hfov_deg"] == pytest.approx(47.222, abs=0.001)

    def test_hdrpano_is_the_published_grid(self, capsys: pytest.CaptureFixture[str]) -> None:
        run(["plan", "--camera", "dji-x5s-45mm", "--method", "hdrpano", "--columns", "21", "--rows", "10", "--json"])
        shots = json.loads(capsys.readouterr().out)["shots"]
        poses = {(round(s["pitch_deg"], 6), round(s["yaw_deg"], 6)) for s in shots}
        published = {(s.pitch_deg, round(s.yaw_deg, 6)) for s in published_plan("scenario-2-hdrpano").shots}
        assert poses == published

    def test_a_zoom_is_planned_at_its_focal_length(self, capsys: pytest.CaptureFixture[str]) -> None:
        camera = ["--camera", "dji-zenmuse-h20-zoom", "--focal-length", "20"]
        run(["plan", *camera, "--method", "paper", "--elevation", "-20", "0", "--azimuth", "0", "60", "--json"])
        document = json.loads(capsys.readouterr().out)
        assert document["camera"]["focal_length_mm"] == 20
        assert document["camera"]["hfov_deg"] == pytest.approx(20.36, abs=0.01)

    def test_exports_and_plots_are_written(self, tmp_path: Path) -> None:
        files = {name: tmp_path / f"plan.{name}" for name in ("csv", "pto", "svg")}
        argv = [
            *PLAN,
            "--export",
            f"csv={files['csv']}",
            "--export",
            f"pto={files['pto']}",
            "--plot",
            str(files["svg"]),
        ]
        assert run(argv) == 1
        assert all(path.stat().st_size > 500 for path in files.values())

    @pytest.mark.parametrize("order", ["fastest", "rows", "columns", "nadir-first", "sky-first"])
    def test_orders_keep_the_shots(self, order: str, capsys: pytest.CaptureFixture[str]) -> None:
        run([*PLAN, "--order", order, "--json"])
        shots = json.loads(capsys.readouterr().out)["shots"]
        assert len({(s["pitch_deg"], s["yaw_deg"]) for s in shots}) == 19
        if order == "nadir-first":
            assert shots[0]["pitch_deg"] == -90
        if order == "sky-first":
            assert shots[0]["pitch_deg"] == max(s["pitch_deg"] for s in shots)

    def test_fit_says_what_would_fit(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert run([*PLAN, "--max-images", "15", "--fit"]) == 2
        err = capsys.readouterr().err
        assert "--elevation -90 13" in err
        assert "would fit" in err
        assert run([*PLAN, "--max-images", "15", "--elevation", "-90", "13"]) == 1
        capsys.readouterr()
        assert run([*PLAN, "--max-images", "15", "--elevation", "-90", "14"]) == 2


class TestVerify:
    @pytest.fixture
    def written(self, tmp_path: Path) -> Path:
        path = tmp_path / "plan.json"
        write_plan(path, published_plan("scenario-3-proposed"))
        return path

    def test_a_good_plan(self, written: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert run(["verify", str(written), "--json"]) == 0
        certificate = json.loads(capsys.readouterr().out)["certificate"]
        assert certificate["certified"] is True
        assert certificate["images"] == 49
        assert certificate["uncovered_fraction"] == 0
        assert certificate["two_edge_connected"] is True
        assert certificate["min_overlap_h"] == pytest.approx(0.2138, abs=1e-4)

    def test_a_published_plan_by_its_name(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        path = tmp_path / "hdrpano.json"
        assert run(["verify", "scenario-2-hdrpano", "--output", str(path)]) == 1
        out = capsys.readouterr().out
        assert "161 images" in out
        assert "at elevation -73.9" in out
        written = json.loads(path.read_text())
        assert len(written["shots"]) == 161
        assert written["certificate"]["certified"] is False
        assert run(["verify", str(path)]) == 1
        assert run(["verify", "scenario-2-hdrpano", "--overlap", "0.1", "--elevation", "-70", "37.7"]) == 0

    def test_options_override_the_file(self, written: Path, capsys: pytest.CaptureFixture[str]) -> None:
        assert run(["verify", str(written), "--overlap", "0.2"]) == 1
        out = capsys.readouterr().out
        assert "NOT CERTIFIED" in out
        assert "C3" in out
        assert run(["verify", str(written), "--tolerance-yaw", "3"]) == 1
        assert run(["verify", str(written), "--elevation", "-90", "20"]) == 1
        assert "C1" in capsys.readouterr().out
        # a longer lens covers less
        assert run(["verify", str(written), "--camera", "dji-x5s-45mm"]) == 1

    def test_a_foreign_file(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        plan = published_plan("scenario-3-proposed")
        path = tmp_path / "foreign.json"
        path.write_text(json.dumps({"shots": [{"pitch_deg": s.pitch_deg, "yaw_deg": s.yaw_deg} for s in plan.shots]}))
        argv = ["verify", str(path), "--camera", "sony-a6000-35mm", "--overlap", "0.15", "--elevation", "-90", "12.2"]
        argv += ["--tolerance-pitch", "0.017", "--tolerance-roll", "0.017", "--tolerance-yaw", "0.667"]
        assert run(argv) == 0
        assert "CERTIFIED" in capsys.readouterr().out

    def test_holes_are_located(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        path = tmp_path / "plan.json"
        write_plan(path, published_plan("scenario-2-hdrpano"))
        plot = tmp_path / "plan.png"
        assert run(["verify", str(path), "--plot", str(plot)]) == 1
        assert "-73.9" in capsys.readouterr().out
        assert plot.read_bytes()[:4] == b"\x89PNG"

    def test_one_missing_shot_is_found(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        plan = published_plan("scenario-3-proposed")
        shots = [s for s in plan.shots if not (s.row == 3 and abs(s.yaw_deg) < 1)]
        assert len(shots) == 48
        path = tmp_path / "plan.json"
        renumbered = tuple(
            type(s)(index=i, row=s.row, pitch_deg=s.pitch_deg, yaw_deg=s.yaw_deg) for i, s in enumerate(shots)
        )
        write_plan(path, Plan(method="published", camera=plan.camera, constraints=plan.constraints, shots=renumbered))
        assert run(["verify", str(path), "--json"]) == 1
        holes = json.loads(capsys.readouterr().out)["certificate"]["holes"]
        assert any(
            abs(hole["azimuth_deg"]) < 25 and math.isclose(hole["elevation_deg"], -40, abs_tol=12) for hole in holes
        )


class TestCameras:
    def test_the_list(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert run(["cameras", "--json"]) == 0
        profiles = json.loads(capsys.readouterr().out)
        assert len(profiles) == len(list((ROOT / "config" / "cameras").glob("*.toml")))
        assert {"name", "hfov_deg", "vfov_deg", "source", "min_interval_s", "orientation"} <= profiles[0].keys()
        assert run(["cameras"]) == 0
        out = capsys.readouterr().out
        assert all(profile["name"] in out for profile in profiles)

    def test_one(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert run(["cameras", "sony-a6000-35mm", "--orientation", "portrait"]) == 0
        out = capsys.readouterr().out
        assert "25.13° × 37.12°" in out
        assert "portrait" in out
        assert "source" in out


class TestProgram:
    def test_help_explains_every_verb(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert run(["--help"]) == 0
        overview = capsys.readouterr().out
        for verb in ("plan", "verify", "cameras", "dry-run"):
            assert verb in overview
        for verb in ("plan", "verify", "cameras"):
            assert run([verb, "--help"]) == 0
            assert "usage" in capsys.readouterr().out

    def test_a_closed_pipe_is_no_error(self) -> None:
        command = f"{sys.executable} -m panoexec cameras --json | head -c 10; exit ${{PIPESTATUS[0]}}"
        done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0
        assert done.stderr == ""

    @pytest.mark.parametrize(
        ("statement", "banned"),
        [
            ("import panoexec.cli.send, panoexec.cli.operate", {"numpy", "mavsdk", "matplotlib", "rich", "sqlite3"}),
            (WATCHING, {"numpy", "mavsdk", "matplotlib", "sqlite3"}),
            ("import panoexec.cli.app as a; a.run(['--help'])", {"numpy", "pydantic", "rich", "mavsdk", "matplotlib"}),
            (
                "import panoexec.cli.app as a; a.run(['cameras'])",
                {"mavsdk", "aiomqtt", "matplotlib", "pymavlink", "asyncio"},
            ),
        ],
    )
    def test_light_verbs_stay_light(self, statement: str, banned: set[str]) -> None:
        assert not loaded_by(statement) & banned

    def test_the_core_is_pure(self) -> None:
        statement = (
            "import importlib, pkgutil, panoexec.planning as p;"
            "[importlib.import_module(f'panoexec.planning.{m.name}') for m in pkgutil.iter_modules(p.__path__)]"
        )
        loaded = loaded_by(statement)
        assert "numpy" in loaded
        assert not loaded & {"mavsdk", "aiomqtt", "paho", "matplotlib", "rich", "pydantic", "pymavlink", "asyncio"}


def loaded_by(statement: str) -> set[str]:
    """Top-level packages that a fresh interpreter has loaded after a statement."""
    code = f"import sys; {statement}\nprint('\\n' + ' '.join({{name.partition('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    return set(done.stdout.splitlines()[-1].split())
