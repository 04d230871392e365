"""Cards are paired whole, or not at all."""

from __future__ import annotations

import hashlib
import json
import random
from pathlib import Path
from typing import Any

import pytest

from panoexec.cli.app import run
from panoexec.errors import PanoexecError
from panoexec.importing.card import read_card
from panoexec.importing.card_import import ContradictedCardError, carry_out, plan_import
from panoexec.store.directory import MissionDirectory
from panoexec.store.landed_mission import LandedMission
from tests.unit.importing.cards import Taken, a_mission, dsc, take, write_photo, write_raw

LAG_S = 0.15


def _fill(
    card: Path,
    taken: list[Taken],
    *,
    off_s: float,
    first: int = 1,
    lost: set[int] = frozenset(),  # type: ignore[assignment]
    strangers: dict[int, float] | None = None,
    raw: bool = False,
    fraction: bool = False,
) -> dict[tuple[int, int], str]:
    """Write the photos with names in the order of time; returns the name of each attempt's."""
    rng = random.Random(len(taken))
    moments: list[tuple[float, Taken | None, int]] = [
        (one.time_s + LAG_S + rng.uniform(-0.1, 0.1), one, number)
        for number, one in enumerate(taken)
        if number not in lost
    ]
    moments += [(time_s, None, 10_000 + number) for number, time_s in (strangers or {}).items()]
    names: dict[tuple[int, int], str] = {}
    for place, (time_s, one, content) in enumerate(sorted(moments, key=lambda moment: moment[0])):
        name = dsc(first + place)
        write_photo(card / name, time_s + off_s, content=content, fraction=fraction)
        if raw:
            write_raw((card / name).with_suffix(".ARW"), content)
        if one is not None:
            names[one.shot, one.attempt] = name
    return names


def _pairs(plan: Any, card: Path) -> dict[tuple[int, int], str]:
    return {
        (item.shot, item.attempt): photo.path.relative_to(card).as_posix() for item, photo in plan.pairing.of_mission
    }


def _stored(directory: MissionDirectory) -> dict[tuple[int, int], Any]:
    landed = LandedMission.read(directory)
    landed.close()
    return {(event.shot, event.attempt): event for event in landed.stored()}


@pytest.mark.parametrize(("hours", "fraction"), [(-2, False), (1, True)])
def test_a_card_with_a_wrong_clock_a_wrapped_counter_strangers_and_lost_photos(
    tmp_path: Path, hours: float, fraction: bool
) -> None:
    taken, card = take(58, seed=7), tmp_path / "card"
    directory = a_mission(tmp_path, taken)
    begin, end = taken[0].time_s, taken[-1].time_s
    off_s = hours * 3600 + 23.4
    strangers = {0: begin - 900, 1: (taken[20].time_s + taken[21].time_s) / 2, 2: end + 45}
    names = _fill(card, taken, off_s=off_s, first=9970, lost={11, 40}, strangers=strangers, fraction=fraction)
    plan = plan_import(directory, card)
    assert _pairs(plan, card) == names
    assert len(plan.strangers) == 3
    assert {(one.shot, one.attempt) for one in plan.missing} == {(taken[n].shot, taken[n].attempt) for n in (11, 40)}
    assert plan.pairing.offset_s == pytest.approx(off_s + LAG_S, abs=0.2)
    assert carry_out(plan, how="copy") == len(names)
    for key, event in _stored(directory).items():
        data = (card / names[key]).read_bytes()
        assert (directory.path / event.file).read_bytes() == data
        assert (event.sha256, event.source) == (hashlib.sha256(data).hexdigest(), "import")


@pytest.mark.parametrize("how", ["copy", "link", "move"])
def test_raw_files_come_along_and_the_card_is_left_as_asked(tmp_path: Path, how: Any) -> None:
    taken, card = take(20, seed=3), tmp_path / "card"
    directory = a_mission(tmp_path, taken)
    names = _fill(card, taken, off_s=3600.0, raw=True)
    before = {path: path.read_bytes() for path in card.rglob("*") if path.is_file()}
    plan = plan_import(directory, card)
    assert _pairs(plan, card) == names
    assert not plan.missing
    assert carry_out(plan, how=how) == len(names)
    for key, event in _stored(directory).items():
        raw = (card / names[key]).with_suffix(".ARW")
        assert (directory.path / event.raw).read_bytes() == before[raw]
        assert Path(event.raw).stem == Path(event.file).stem
        assert raw.exists() is (how != "move")
        assert how == "move" or ((directory.path / event.raw).stat().st_ino == raw.stat().st_ino) is (how == "link")
    assert bool([path for path in card.rglob("*") if path.is_file()]) is (how != "move")


@pytest.mark.parametrize("linked", [False, True])
def test_a_card_that_was_copied_into_the_mission_is_not_removed_from_it(tmp_path: Path, linked: bool) -> None:
    taken = take(20, seed=3)
    directory = a_mission(tmp_path, taken)
    names = _fill(tmp_path / "sd", taken, off_s=3600.0, raw=True)
    directory.images.mkdir(exist_ok=True)
    for path in [path for path in (tmp_path / "sd").rglob("*") if path.is_file()]:
        path.rename(directory.images / path.name)
    card = directory.images
    if linked:
        card = tmp_path / "card"
        card.mkdir()
        for path in directory.images.iterdir():
            (card / path.name).symlink_to(path)
    before = {path.name: path.read_bytes() for path in directory.images.iterdir()}
    assert carry_out(plan_import(directory, card), how="move") == len(names)
    assert {path.name: path.read_bytes() for path in directory.images.iterdir()} == before
    assert carry_out(plan_import(directory, directory.path), how="move") == len(names), "again"
    assert {path.name: path.read_bytes() for path in directory.images.iterdir()} == before


def test_two_missions_on_one_card_even_of_the_same_plan(tmp_path: Path) -> None:
    one = take(30, seed=5)
    again = take(
        30, seed=5, begin_s=one[-1].time_s + 400
    )  # the same intervals: only the other mission tells them apart
    first, second = a_mission(tmp_path, one), a_mission(tmp_path, again)
    card = tmp_path / "card"
    names_one = _fill(card, one, off_s=-7200.0, raw=True)
    names_two = _fill(card, again, off_s=-7200.0, first=len(one) + 1)
    assert _pairs(plan_import(first, card), card) == names_one
    assert _pairs(plan_import(second, card), card) == names_two


def test_a_card_that_is_one_off_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Photos at even intervals: the first is lost, and somebody took one more right after the last."""
    taken, card = take(60, seed=2, every_s=(3.0, 3.0)), tmp_path / "card"
    directory = a_mission(tmp_path, taken)
    _fill(card, taken, off_s=3600.0, lost={0}, strangers={0: taken[-1].time_s + 3.0})
    with pytest.raises(ContradictedCardError, match=r"two pairings are nearly as good \(shot \d+, attempt 1 "):
        plan_import(directory, card)
    assert run(["import", str(directory.path), str(card)]) == 2
    assert not directory.images.exists()
    assert not directory.manifest.exists()
    assert "nothing was imported" in capsys.readouterr().err


def test_what_the_content_contradicts_is_refused(tmp_path: Path) -> None:
    taken, card = take(12, seed=1), tmp_path / "card"
    directory = a_mission(tmp_path, taken)
    _fill(card, taken, off_s=0.0)
    with pytest.raises(ContradictedCardError, match="shows something else"):
        plan_import(directory, card, confirm=lambda pairs, **_: ([f"{pairs[3][1].path} shows something else"], ""))


def test_a_stranger_in_the_same_second_is_not_taken_for_the_photo(tmp_path: Path) -> None:
    taken, card = take(12, seed=1), tmp_path / "card"
    directory = a_mission(tmp_path, taken)
    _fill(card, taken, off_s=0.0, strangers={0: taken[5].time_s + 0.2})
    with pytest.raises(ContradictedCardError, match="may also be"):
        plan_import(directory, card)


def test_a_repeated_import_adds_nothing_and_a_second_card_adds_the_rest(tmp_path: Path) -> None:
    taken, card, rest = take(20, seed=4), tmp_path / "card", tmp_path / "rest"
    directory = a_mission(tmp_path, taken)
    _fill(card, taken, off_s=0.0, lost=set(range(12, 22)))
    carry_out(plan_import(directory, card), how="copy")
    events = LandedMission.read(directory).record.seq
    again = plan_import(directory, card)
    assert carry_out(again, how="copy") == 12 and LandedMission.read(directory).record.seq == events  # noqa: PT018
    assert len(again.missing) == len({one.shot for one in taken[12:]})
    _fill(rest, taken, off_s=0.0, first=500, lost=set(range(12)))
    last = plan_import(directory, rest)
    assert not last.missing
    carry_out(last, how="copy")
    assert len(_stored(directory)) == len(taken)


def test_bad_cards_are_named_and_change_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    taken, card = take(12, seed=1), tmp_path / "card"
    directory = a_mission(tmp_path, taken)
    empty = tmp_path / "empty"
    empty.mkdir()
    for folder, problem in ((tmp_path / "none", "no such folder"), (empty, "has no photos")):
        assert run(["import", str(directory.path), str(folder)]) == 2
        assert problem in capsys.readouterr().err
    assert run(["import", str(tmp_path / "nowhere"), str(empty)]) == 2
    names = _fill(card, taken, off_s=0.0)
    broken = card / names[3, 1]
    broken.write_bytes(broken.read_bytes()[:300])
    write_photo(card / names[4, 1], 0, content=4)
    problems = {path.name: why for path, why in read_card(card).problems}
    assert "cut off" in problems[broken.name]
    assert problems[Path(names[4, 1]).name] == "has no EXIF time"
    assert run(["import", str(directory.path), str(card), "--dry-run"]) == 1
    shown = capsys.readouterr()
    assert "cut off" in shown.err
    assert "no photo of shot 3, attempt 1" in shown.err
    assert not directory.images.exists()
    write_photo(tmp_path / "other" / "1.JPG", 0, content=1)
    with pytest.raises(PanoexecError, match="no photo fits"):
        plan_import(directory, tmp_path / "other")


def test_the_command_stores_and_writes_anew(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    taken, card = take(12, seed=1), tmp_path / "card"
    directory = a_mission(tmp_path, taken)
    names = _fill(card, taken, off_s=-90.0)
    assert run(["import", str(directory.path), str(card), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["stored"], told["missing"], len(told["pairs"])) == (len(taken), [], len(taken))
    assert told["clock_offset_s"] == pytest.approx(-90 + LAG_S, abs=0.3)
    manifest = json.loads(directory.manifest.read_text())
    for shot in manifest["shots"]:
        assert shot["file"] == f"images/{Path(names[shot['index'], shot['accepted_attempt']]).name}"
        assert shot["sha256"]
    assert "images/DSC00001.JPG" in (directory.path / "panorama.pto").read_text()
    assert (directory.path / "report.html").exists()
