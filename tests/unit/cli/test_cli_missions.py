"""`missions` and `fetch`: what is stored is listed, and comes here whole."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from panoexec.cli import fetch
from panoexec.cli.app import run
from panoexec.importing.card_import import carry_out, plan_import
from panoexec.report.mission_outputs import restore_outputs
from panoexec.store.directory import MissionDirectory
from panoexec.store.photo_store import hash_file
from tests.unit.importing.cards import a_mission, take, write_photo


@pytest.fixture
def mission(tmp_path: Path) -> MissionDirectory:
    """A mission of twenty shots, all but the last with their photo."""
    taken, card = take(20, seed=1), tmp_path / "card"
    directory = a_mission(tmp_path / "drone", taken)
    for number, one in enumerate(taken[:-1]):
        write_photo(card / f"{number}.JPG", one.time_s, content=number)
    carry_out(plan_import(directory, card), how="copy")
    restore_outputs(directory)
    return directory


def test_missions_are_listed_with_state_photos_and_size(
    mission: MissionDirectory, capsys: pytest.CaptureFixture[str]
) -> None:
    storage = str(mission.path.parent.parent)
    (mission.path.parent / "20270101T000000.000Z").mkdir()  # its process ended before it began
    assert run(["missions", "--storage", storage, "--json"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)
    assert (entry["mission_id"], entry["state"], entry["shots_done"], entry["photos"]) == (
        mission.mission_id, "complete", 20, 19,
    )  # fmt: skip
    assert entry["size_bytes"] == sum(path.stat().st_size for path in mission.path.rglob("*") if path.is_file())
    mission.manifest.write_text("{")
    mission.journal.write_bytes(b"x")
    assert run(["missions", "--storage", storage]) == 0
    shown = capsys.readouterr()
    assert "damaged" in shown.out
    assert mission.mission_id in shown.err
    assert run(["missions", "--storage", f"{storage}/none"]) == 2
    assert "--storage DIR" in capsys.readouterr().err


def test_a_mission_comes_whole_from_a_folder_and_again_only_what_is_new(
    mission: MissionDirectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    storage, here = mission.path.parent.parent, tmp_path / "here"
    (mission.path / ".incoming").mkdir()
    (mission.path / ".incoming" / "4-1-1").write_bytes(b"half")
    assert run(["fetch", "--from", str(storage), "--to", str(here)]) == 0
    copy = here / mission.mission_id
    assert capsys.readouterr().out.strip() == str(copy)
    theirs = {path.relative_to(mission.path) for path in mission.path.rglob("*") if ".incoming" not in path.parts}
    assert {path.relative_to(copy) for path in copy.rglob("*")} == theirs
    kept = copy / "images" / "0.JPG"
    inode = kept.stat().st_ino
    (copy / "images" / "1.JPG").unlink()
    assert run(["fetch", mission.mission_id, "--from", str(storage), "--to", str(here)]) == 0
    assert kept.stat().st_ino == inode, "not copied again"
    assert (copy / "images" / "1.JPG").exists()
    (mission.images / "2.JPG").write_bytes(b"another")
    (mission.images / "3.JPG").unlink()
    (copy / "images" / "3.JPG").unlink()
    assert run(["fetch", "--from", str(storage), "--to", str(here)]) == 1
    err = capsys.readouterr().err
    assert "shot 2: images/2.JPG is not the photo of the manifest" in err
    assert "shot 3: images/3.JPG is missing" in err


def test_a_mission_comes_by_rsync_from_another_computer(
    mission: MissionDirectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if shutil.which("rsync") is None:
        pytest.skip("rsync is not installed")
    shell = tmp_path / "ssh"  # the other computer is this one
    shell.write_text('#!/bin/sh\n[ "$1" = -l ] && shift 2\nshift\nexec sh -c "$*"\n')
    shell.chmod(0o755)
    monkeypatch.setenv("RSYNC_RSH", str(shell))
    storage, here = mission.path.parent.parent, tmp_path / "here"
    assert run(["fetch", "--from", f"pi@drone.local:{storage}", "--to", str(here), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"mission": str(here / mission.mission_id), "problems": []}
    assert (here / mission.mission_id / "images" / "0.JPG").read_bytes() == (mission.images / "0.JPG").read_bytes()
    assert run(["fetch", "20200101T000000.000Z", "--from", f"drone:{storage}", "--to", str(here)]) == 3
    assert "rsync failed" in capsys.readouterr().err
    shell.write_text(
        "#!/bin/sh\necho \"Warning: Permanently added 'drone' to the list of known hosts.\" >&2\n"
        "echo 'rsync: [sender] change_dir \"/srv/missions\" failed: Permission denied (13)' >&2\nexit 23\n"
    )
    assert run(["fetch", "--from", f"pi@drone.local:{storage}", "--to", str(here)]) == 3
    refused = 'change_dir "/srv/missions" failed: Permission denied (13) (there, as root: adduser USER panoexec)'
    assert f"panoexec: rsync failed: rsync: [sender] {refused}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["../etc", "--from", "drone"], "not a mission id"),
        (["--from", "/nowhere/at/all"], "no such folder"),
        (["--from", "-oProxyCommand=x"], "expected"),
        (["--from", "-e@host:/srv"], "expected"),
    ],
)
def test_what_makes_no_sense_is_named(arguments: list[str], problem: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["fetch", *arguments]) == 2
    assert problem in capsys.readouterr().err


def test_a_copy_into_which_a_card_was_imported_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    taken, card, here = take(20, seed=1), tmp_path / "card", tmp_path / "here"
    mission = a_mission(tmp_path / "drone", taken)
    restore_outputs(mission)
    for number, one in enumerate(taken):
        write_photo(card / f"{number}.JPG", one.time_s, content=number)
    storage = mission.path.parent.parent
    assert run(["fetch", "--from", str(storage), "--to", str(here)]) == 0
    copy = MissionDirectory(here / mission.mission_id)
    carry_out(plan_import(copy, card), how="move")
    journal = copy.journal.read_bytes()
    shell = tmp_path / "ssh"  # the other computer is this one
    shell.write_text('#!/bin/sh\n[ "$1" = -l ] && shift 2\nshift\nexec sh -c "$*"\n')
    shell.chmod(0o755)
    monkeypatch.setenv("RSYNC_RSH", str(shell))
    sources = [str(storage), *([f"pi@drone.local:{storage}"] if shutil.which("rsync") else [])]
    for source in sources:
        capsys.readouterr()
        assert run(["fetch", "--from", source, "--to", str(here)]) == 2
        assert "more than the mission there" in capsys.readouterr().err
        assert copy.journal.read_bytes() == journal
    assert (copy.images / "19.JPG").exists()


def test_every_photo_of_a_bracket_is_verified(
    mission: MissionDirectory, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    digests = [hash_file(mission.images / f"{number}.JPG")[1] for number in range(3)]
    photos = [{"file": f"images/{number}.JPG", "sha256": digest} for number, digest in enumerate(digests)]
    attempts = [{"number": 1, "photos": photos[::-1]}, {"number": 2, "photos": photos}]
    shot = {"index": 0, "accepted_attempt": 2, **photos[0], "attempts": attempts}
    monkeypatch.setattr(fetch, "read_manifest", lambda _: {"shots": [shot]})
    assert fetch._problems(mission) == ([], 3, 0)
    (mission.images / "1.JPG").unlink()
    (mission.images / "2.JPG").write_bytes(b"another")
    told = ["shot 0: images/1.JPG is missing", "shot 0: images/2.JPG is not the photo of the manifest"]
    assert fetch._problems(mission) == (told, 1, 0)


def test_photos_without_a_hash_are_said_to_be_unverified(
    mission: MissionDirectory, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shots = [
        {"index": n, "accepted_attempt": 1, "file": file, "sha256": None, "attempts": [{"number": 1}]}
        for n, file in enumerate(["images/0.JPG", "images/1.JPG", "/DCIM/100/ON_THE_CARD.JPG"])
    ]
    monkeypatch.setattr(fetch, "read_manifest", lambda _: {"shots": shots})
    assert fetch._problems(mission) == ([], 0, 2)
    assert run(["fetch", "--from", str(mission.path.parent.parent), "--to", str(mission.path.parent.parent / "x")]) == 0
    assert "no photo was verified; 2 photos came without a hash in the manifest" in capsys.readouterr().err


def test_members_of_the_group_can_read_what_the_service_writes(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        directory = a_mission(tmp_path, take(3, seed=1))
        restore_outputs(directory)
    finally:
        os.umask(before)
    for path in (directory.path, *directory.path.rglob("*")):
        mode = path.stat().st_mode & 0o777
        assert mode == (0o750 if path.is_dir() else 0o640), path


def test_where_hugin_is_missing_no_step_of_the_stitcher_is_shown(
    mission: MissionDirectory, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    restore_outputs(mission)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    assert run(["stitch", str(mission.path)]) == 3
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("left out: ")]
    assert [line.partition(" (")[0] for line in lines] == ["panoexec: Hugin's tools are not installed"]
