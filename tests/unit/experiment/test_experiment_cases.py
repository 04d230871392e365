"""The experiment's cases, pointing errors and figures, without a stitcher."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from panoexec.angles import rotation
from panoexec.cli.app import run
from panoexec.errors import UsageError
from panoexec.experiment import running
from panoexec.experiment.capture import PointingErrors, true_rotations, write_capture
from panoexec.experiment.cases import TABLE_2, Case, cases, plan_of
from panoexec.experiment.running import Outcome, Setting, misalignment_deg, run_cases
from panoexec.planning.baselines.published import PAPER_TOLERANCE
from panoexec.planning.geometry.pose_error import pose_error
from panoexec.sim.photos.scene import procedural_scene
from panoexec.stitching.mission import load_mission
from panoexec.store.manifest import read_manifest


def an_outcome(case: Case, *, hole_px: int = 0) -> Outcome:
    return Outcome(
        scenario=case.scenario, plan=case.plan, seed=case.seed, repeat=case.repeat, images=21, photo_width_px=64,
        completeness=1 - hole_px / 1_000_000, holes=min(1, hole_px), hole_px=hole_px, ground_px=1_000_000,
        hole_elevations_deg=(-73.9,) if hole_px else (), untied=0, misalignment_deg=0.01, seconds=1.0,
    )  # fmt: skip


@pytest.mark.parametrize(("scenario", "goal"), [(1, 21), (2, 138), (3, 40)])
def test_certified_plans_need_fewer_images_than_table_2(scenario: int, goal: int) -> None:
    plan = plan_of(scenario, "certified")
    assert plan.certificate is not None
    assert plan.certificate.certified
    assert plan.constraints.tolerance == PAPER_TOLERANCE
    assert len(plan.shots) <= goal < TABLE_2[scenario, "proposed"].images


@pytest.mark.parametrize("key", list(TABLE_2))
def test_published_plans_have_the_images_of_table_2(key: tuple[int, str]) -> None:
    assert len(plan_of(*key).shots) == TABLE_2[key].images


def test_all_cases_seed_by_seed() -> None:
    found = cases((1, 3), ("proposed", "hdrpano", "certified"), 2, 1)
    assert [(case.scenario, case.plan, case.seed) for case in found[:5]] == [
        (1, "proposed", 1),
        (1, "hdrpano", 1),
        (1, "certified", 1),
        (3, "proposed", 1),
        (3, "certified", 1),
    ]
    assert len(found) == 10
    assert len({case.name for case in cases((1, 2, 3), ("proposed", "hdrpano", "certified"), 3, 2)}) == 8 * 6
    with pytest.raises(UsageError, match="no HDRpano plan for Scenario 3"):
        cases((3,), ("hdrpano",), 1, 1)


@pytest.mark.parametrize("spread", ["uniform", "normal"])
def test_errors_are_those_of_the_paper_in_the_gimbals_axes(spread: str) -> None:
    plan = plan_of(2, "proposed")
    errors = PointingErrors(size=PAPER_TOLERANCE, spread=spread, seed=4)  # type: ignore[arg-type]
    truth = true_rotations(plan, errors)
    found = [pose_error(shot.pitch_deg, shot.yaw_deg, pose) for shot, pose in zip(plan.shots, truth, strict=True)]
    drawn = np.array([[error.yaw_deg, error.pitch_deg, error.roll_deg] for error in found], dtype=float)
    sizes = np.array([0.667, 0.017, 0.017])
    if spread == "uniform":
        assert (np.abs(drawn) <= sizes + 1e-9).all()
        assert np.allclose(drawn.std(axis=0), sizes / np.sqrt(3), rtol=0.15)
    else:
        assert np.allclose(drawn.std(axis=0), sizes, rtol=0.15)
    assert np.array_equal(truth, true_rotations(plan, errors))
    assert not np.array_equal(truth, true_rotations(plan, replace(errors, seed=5)))


def test_a_capture_tells_where_it_aimed_and_holds_what_it_saw(tmp_path: Path) -> None:
    plan = plan_of(1, "certified")
    errors = PointingErrors(size=PAPER_TOLERANCE, spread="uniform", seed=1)
    folder = tmp_path / "capture"
    truth = write_capture(folder, plan, procedural_scene(1, 512), width_px=32, errors=errors)
    shots = read_manifest(folder / "manifest.json")["shots"]
    aimed = [shot["attempts"][0]["measured"] for shot in shots]
    assert [pose["yaw_deg"] for pose in aimed] == pytest.approx([shot.yaw_deg for shot in plan.shots])
    assert not np.allclose(truth, true_rotations(plan, None))
    mission = load_mission(folder)
    assert len(mission.project.images) == len(plan.shots)
    assert mission.left_out == {}


def test_misalignment_is_what_is_left_after_the_best_turn_of_the_whole() -> None:
    truth = rotation(np.linspace(-180, 150, 12), np.linspace(-80, 40, 12))
    whole = rotation(13.0, -7.0, 2.0)
    assert misalignment_deg(whole @ truth, truth) == pytest.approx(0.0, abs=1e-5)
    off = truth @ rotation(np.where(np.arange(12) % 2, 0.1, -0.1), 0.0)
    assert misalignment_deg(whole @ off, truth) == pytest.approx(0.1, rel=0.05)
    assert np.isnan(misalignment_deg(truth[:0], truth[:0]))


def test_a_finished_case_is_not_run_again_unless_the_setting_is_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs: list[str] = []

    def judge(work: running._Work, scene: object, progress: object) -> Outcome:
        runs.append(work._case.name)
        outcome = an_outcome(work._case)
        work._folder.mkdir(parents=True, exist_ok=True)
        fields = {name: getattr(outcome, name) for name in Outcome.__slots__}
        document = {"key": work._key, "outcome": fields}
        work._result.write_text(json.dumps(document), encoding="utf-8")
        return outcome

    monkeypatch.setattr(running, "check_tools", lambda: None)
    monkeypatch.setattr(running, "_scene", lambda _: procedural_scene(1, 64))
    monkeypatch.setattr(running._Work, "run", judge)
    wanted = cases((1,), ("proposed",), 2, 1)
    told: list[str] = []

    def again(setting: Setting) -> list[Outcome]:
        return run_cases(wanted, setting, lambda case, step, _, __: told.append(f"{case.seed} {step}"))

    setting = Setting(output=tmp_path)
    first = again(setting)
    assert len(runs) == 2
    assert again(setting) == first
    assert len(runs) == 2
    assert told == ["1 done", "2 done"]
    again(replace(setting, spread="normal"))
    again(replace(setting, width_px=128))
    again(replace(setting, restart=True, width_px=128))
    assert len(runs) == 8
    # a result that was damaged is none
    (tmp_path / wanted[0].name / "outcome.json").write_text("{", encoding="utf-8")
    again(replace(setting, width_px=128))
    assert len(runs) == 9


def shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], hole_px: dict[str, int]
) -> tuple[int, str, str]:
    def all_run(wanted: list[Case], setting: Setting, progress: object) -> list[Outcome]:
        return [an_outcome(case, hole_px=hole_px.get(case.plan, 0)) for case in wanted]

    monkeypatch.setattr(running, "run_cases", all_run)
    code = run(["experiment", *arguments])
    out, err = capsys.readouterr()
    return code, out, err


def test_the_table_stands_beside_the_papers_and_holes_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = shown(monkeypatch, capsys, ["--scenario", "2", "--seeds", "3"], {"hdrpano": 10})
    assert code == 0
    assert "99.97 %" in out
    assert "99.9990 %" in out or "99.999 %" in out
    lines = [line for line in out.splitlines() if " certified " in line]
    assert len(lines) == 1
    assert "100.00 %" in lines[0]
    assert "scenario 2, hdrpano, seed 1: 1 holes (10 of 1000000 px), at elevation -73.9°" in err


def test_a_certified_plan_with_holes_ends_with_1_and_json_holds_every_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = shown(monkeypatch, capsys, ["--scenario", "1", "--seeds", "2", "--json"], {"certified": 1})
    assert code == 1
    document = json.loads(out)
    assert document["format"] == "panoexec.experiment/1"
    assert [(o["plan"], o["seed"]) for o in document["outcomes"]] == [
        (plan, seed) for seed in (1, 2) for plan in ("proposed", "hdrpano", "certified")
    ]


def test_without_hugin_it_says_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert run(["experiment", "--scenario", "1", "--output", str(tmp_path / "out")]) == 3
    assert "install them with apt-get install hugin-tools" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["--scenario", "4"], "invalid choice: '4'"),
        (["--seeds", "0"], "1 to 1000"),
        (["--width", "12"], "128 to 20000 px"),
        (["--plans", "mine"], "invalid choice: 'mine'"),
        (["--scenario", "3", "--plans", "hdrpano"], "no HDRpano plan for Scenario 3"),
    ],
)
def test_wrong_usage(arguments: list[str], part: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["experiment", *arguments]) == 2
    err = capsys.readouterr().err
    assert part in err
    assert len(err.strip().splitlines()) == 1


def test_an_output_that_cannot_be_written_and_a_scene_that_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(running, "check_tools", lambda: None)
    (tmp_path / "file").touch()
    scene = tmp_path / "scene.png"
    assert run(["experiment", "--scenario", "1", "--scene", str(scene), "--output", str(tmp_path)]) == 2
    assert "no such file; name an equirectangular" in capsys.readouterr().err
    monkeypatch.setattr(running, "_scene", lambda _: procedural_scene(1, 64))
    assert run(["experiment", "--scenario", "1", "--output", str(tmp_path / "file")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_geometry_alone_finds_the_holes_of_hdrpanos_plan_and_none_in_certified_ones(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["experiment", "--geometry", "--scenario", "2", "--seeds", "2", "--plans", "hdrpano", "certified"]
    assert run([*arguments, "--json"]) == 0
    hdrpano, certified = json.loads(capsys.readouterr().out)["flights"]
    assert (certified["plan"], certified["complete"], certified["holes"]) == ("certified", 2, 0)
    assert (hdrpano["plan"], hdrpano["complete"], hdrpano["holes"]) == ("hdrpano", 0, 4)
    assert hdrpano["elevation_deg"] == pytest.approx(-74, abs=1)
