"""What goes wrong at the command line: one clear line on stderr, the documented exit code, nothing half-written."""

import json
import os
from pathlib import Path

import pytest

import panoexec
from panoexec.cli.app import run

PLAN = ["plan", "--camera", "dji-x5s-15mm", "--method", "paper"]


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(
        'sensor_height_mm = -13.0\nimage_width_px = 5280\nimage_height_px = 3956\nfocal_length_mm = 15\nsource = "x"\n'
    )
    return path


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        ([], None),
        (["fly"], "unknown command 'fly'"),
        (["plam"], "did you mean 'plan'"),
        (["plan"], "--camera"),
        (["plan", "--camra", "x"], "unknown option --camra: did you mean --camera?"),
        ([*PLAN, "--overlap", "15%"], "'15%' is not a number: write 0.15"),
        ([*PLAN, "--overlap", "much%"], "'much%' is not a number"),
        (["check-config"], "name one configuration file"),
        (["check-config", "--config", "none.toml"], "none.toml: cannot be read: there is no such file"),
        ([*PLAN, "--speed", "3"], "--speed"),
        (["plan", "--camera", "dji-x5s"], "did you mean dji-x5s-"),
        (["cameras", "nikon"], "no camera profile 'nikon'"),
        (["plan", "--camera", "missing.toml"], "missing.toml: cannot be read"),
        (["plan", "--camera", "dji-x5s-15mm", "--focal-length", "25"], "fixed lens of 15 mm"),
        (["plan", "--camera", "dji-x5s-15mm", "--focal-length", "-3"], "more than 0"),
        (["plan", "--camera", "dji-x5s-15mm", "--orientation", "diagonal"], "landscape"),
        ([*PLAN, "--overlap", "1.2"], "overlap 1.2 is out of range: give a fraction from 0 to below 1"),
        ([*PLAN, "--overlap", "15"], "15 % is 0.15"),
        ([*PLAN, "--overlap", "-0.1"], "overlap -0.1"),
        ([*PLAN, "--overlap", "nan"], "'nan' is not a number"),
        ([*PLAN, "--overlap-v", "1"], "vertical overlap 1"),
        ([*PLAN, "--overlap", "much"], "'much' is not a number"),
        ([*PLAN, "--elevation", "30", "-90"], "elevation 30 to -90° is reversed"),
        ([*PLAN, "--elevation", "-90", "91"], "out of range"),
        ([*PLAN, "--elevation", "-90"], "--elevation"),
        ([*PLAN, "--elevation", "0", "0"], "empty"),
        ([*PLAN, "--azimuth", "90", "90"], "is empty"),
        ([*PLAN, "--tolerance-yaw", "-1"], "yaw tolerance -1"),
        ([*PLAN, "--tolerance-roll", "inf"], "'inf' is not a number"),
        ([*PLAN, "--guarantee", "everything"], "coverage"),
        ([*PLAN, "--method", "magic"], "certified"),
        ([*PLAN, "--method", "hdrpano"], "needs --columns N and --rows N"),
        ([*PLAN, "--method", "hdrpano", "--columns", "0", "--rows", "3"], "--columns"),
        ([*PLAN, "--gimbal-pitch", "-30", "30"], "the gimbal reaches -30 to 30"),
        ([*PLAN, "--gimbal-pitch", "30", "-30"], "reversed"),
        ([*PLAN, "--max-images", "5"], "the plan needs 19 images, 5 are allowed"),
        ([*PLAN, "--max-duration", "10"], "10 s are allowed"),
        ([*PLAN, "--export", "kml=x.kml"], "pto"),
        ([*PLAN, "--export", "pto"], "FORMAT=FILE"),
        ([*PLAN, "--plot", "plan.docx"], "plan.docx"),
        ([*PLAN, "--output", "no/such/folder/plan.json"], "no/such/folder"),
        (["verify", "no.json"], "no.json: cannot be read"),
        (["verify", "scenario-9"], "neither a file nor a published plan (published: scenario-1-proposed"),
        (["send"], "the following arguments are required: COMMAND (see"),
        (["send", "start", "--plan", "no.json"], "--plan no.json: cannot be read: No such file or directory"),
        (["send", "start", "--plan", __file__], "is not valid JSON"),
        (["check-config", "none.toml"], "none.toml: cannot be read: there is no such file; copy config/"),
        (["verify"], "PLAN.json"),
        (["doctor", "--config", "none.toml"], "none.toml: cannot be read"),
        (["doctor", "--timeout", "0"], "--timeout"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(
    argv: list[str],
    says: str | None,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(argv) == 2
    out, err = capsys.readouterr()
    assert list(tmp_path.iterdir()) == []
    if says is None:
        return  # the overview, on stdout
    assert out == ""
    assert says in err
    assert err.count("\n") == 1
    assert "Traceback" not in err


def test_all_problems_of_a_profile_come_at_once(profile: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", "--camera", str(profile)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert str(profile) in err
    assert "sensor_width_mm is missing" in err
    assert "sensor_height_mm is -13.0" in err


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ('{"format": "panoexec.plan/1", "shots": [{"pitch', "not valid JSON (truncated?)"),
        ('{"shots": []}', "shots is []"),
        ('{"shots": [{"pich_deg": 0, "yaw_deg": 0}]}', "shots[0].pitch_deg is missing: is pich_deg meant?"),
        ('{"shots": [{"yaw_deg": 0, "index": 3}]}', "shots[0].pitch_deg is missing\n"),
        ('{"shots": [{"pitch_deg": NaN, "yaw_deg": 0}]}', "shots[0].pitch_deg is nan"),
        ('{"shots": [{"pitch_deg": 1e9, "yaw_deg": 0}]}', "shots[0].pitch_deg is 1000000000.0"),
        ("[1, 2]", "JSON object"),
        ("\x00\x01", "not valid JSON"),
    ],
)
def test_a_damaged_plan_file(content: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plan.json"
    path.write_text(content)
    assert run(["verify", str(path), "--camera", "dji-x5s-15mm"]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert str(path) in err
    assert err.count("\n") == 1


def test_a_foreign_plan_needs_a_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plan.json"
    path.write_text(json.dumps({"shots": [{"pitch_deg": 0, "yaw_deg": 0}]}))
    assert run(["verify", str(path)]) == 2
    assert "contains no camera: give --camera" in capsys.readouterr().err


def test_an_unwritable_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    if os.geteuid() == 0:
        folder = Path("/proc")  # where not even root may write
    assert run([*PLAN, "--output", str(folder / "plan.json")]) == 2
    assert "cannot be written" in capsys.readouterr().err
    assert not (folder / "plan.json").exists()


def test_a_folder_instead_of_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*PLAN, "--output", str(tmp_path)]) == 2
    assert "is a folder" in capsys.readouterr().err


def test_a_full_disk_leaves_the_old_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "plan.json"
    path.write_text("old")

    def no_space(_self: Path, _data: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", no_space)
    assert run([*PLAN, "--output", str(path)]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("word", ["version", "--version", "-V"])
def test_the_version_is_a_command_too(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([word]) == 0
    assert capsys.readouterr().out == f"panoexec {panoexec.__version__}\n"
    assert run(["verson"]) == 2
    assert "did you mean 'version'?" in capsys.readouterr().err


def test_help_of_a_command_is_also_asked_for_before_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["help", "missions"]) == 0
    asked = capsys.readouterr().out
    assert run(["missions", "--help"]) == 0
    assert capsys.readouterr().out == asked
    assert asked.startswith("usage: panoexec missions")
    assert run(["help", "misions"]) == 2
    assert "did you mean 'missions'?" in capsys.readouterr().err


def test_an_interrupt_is_130(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted(*_args: object, **_kwargs: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("panoexec.inputs.plan_spec.make_plan", interrupted)
    assert run(PLAN) == 130
    err = capsys.readouterr().err
    assert "interrupted" in err
    assert "Traceback" not in err


def test_a_bug_is_no_traceback_either(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def broken(*_args: object, **_kwargs: object) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr("panoexec.inputs.plan_spec.make_plan", broken)
    assert run(PLAN) == 1
    err = capsys.readouterr().err
    assert "a bug" in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("written", "says"),
    [
        ('[mqtt]\nhots = "x"', "mqtt.hots is not a known key: did you mean host?"),
        ("[mission]\nelevation = [-10, 10]", "mission.elevation is not a known key: did you mean elevation_deg?"),
        ('[vehicel]\nid = "x"', "vehicel is not a known key: did you mean vehicle?"),
        ("[camera]\nxyzzy = 1", "camera.xyzzy is not a known key"),
    ],
)
def test_an_unknown_key_of_the_configuration_gets_the_nearest_one(
    written: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "config.toml"
    config.write_text(written)
    assert run(["check-config", str(config)]) == 2
    assert capsys.readouterr().err == f"panoexec: {config}: {says}\n"


def test_a_profile_with_two_focal_lengths_is_told_what_a_zoom_lens_needs(
    profile: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    profile.write_text(profile.read_text().replace("focal_length_mm = 15", "focal_length_mm = [24, 105]"))
    assert run(["plan", "--camera", str(profile)]) == 2
    assert "use zoom_range_mm = [shortest, longest]" in capsys.readouterr().err
