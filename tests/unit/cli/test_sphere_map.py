"""The map of the sphere: which direction has which mark, and what a terminal shows of it."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from panoexec.angles import rotation
from panoexec.cli.dry_run_view import MissionView, marks_of
from panoexec.cli.sphere_map import CAPTIONS, HEIGHT, LEGEND, MARGIN, WIDTH, Mark, SphereMap, size_for
from panoexec.devices import EvidenceLevel
from panoexec.mission.executor import Mission
from panoexec.mission.log import events as ev
from panoexec.mission.log.record import MissionRecord
from panoexec.optics import Camera
from panoexec.planning.model import Shot
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_world

CAMERA = Camera.from_fov(60.0, 45.0)


def a_shot(index: int, pitch_deg: float, yaw_deg: float) -> Shot:
    return Shot(index=index, row=0, pitch_deg=pitch_deg, yaw_deg=yaw_deg)


def a_map(camera: Camera, *, width: int = WIDTH, height: int = HEIGHT) -> SphereMap:
    return SphereMap(camera.half_width, camera.half_height, width=width, height=height)


def mark_at(pixels: list[list[Mark]], elevation_deg: float, azimuth_deg: float) -> Mark:
    row = int((90.0 - elevation_deg) / 180.0 * 2 * HEIGHT)
    column = int((azimuth_deg + 180.0) / 360.0 * WIDTH)
    return pixels[row][column]


def test_an_image_marks_what_it_sees_and_nothing_else() -> None:
    pixels = a_map(CAMERA).pixels([a_shot(0, -20.0, 90.0)], {0: Mark.DONE})
    assert np.shape(pixels) == (2 * HEIGHT, WIDTH)
    assert mark_at(pixels, -20.0, 90.0) is Mark.DONE
    assert mark_at(pixels, -20.0 + 18.0, 90.0) is Mark.DONE
    assert mark_at(pixels, -20.0 + 28.0, 90.0) is Mark.OUTSIDE
    assert mark_at(pixels, -20.0, 90.0 + 26.0) is Mark.DONE
    assert mark_at(pixels, -20.0, 90.0 + 36.0) is Mark.OUTSIDE
    assert mark_at(pixels, -20.0, -90.0) is Mark.OUTSIDE


def test_the_nadir_is_the_whole_lowest_row_and_the_back_is_both_ends() -> None:
    pixels = a_map(CAMERA).pixels([a_shot(0, -90.0, 0.0), a_shot(1, 0.0, -180.0)], {0: Mark.DONE, 1: Mark.MISSING})
    assert set(pixels[-1]) == {Mark.DONE}
    assert mark_at(pixels, 1.0, 178.0) is mark_at(pixels, 1.0, -178.0) is Mark.MISSING


def test_what_one_image_has_is_no_gap_of_another() -> None:
    shots = [a_shot(0, 0.0, 0.0), a_shot(1, 0.0, 30.0)]
    pixels = a_map(CAMERA).pixels(shots, {0: Mark.DONE, 1: Mark.MISSING})
    assert mark_at(pixels, 1.0, 15.0) is Mark.DONE
    assert mark_at(pixels, 1.0, 45.0) is Mark.MISSING


def test_an_image_smaller_than_a_character_is_still_there() -> None:
    pixels = a_map(Camera.from_fov(2.0, 1.5)).pixels([a_shot(0, 11.0, 33.0)], {0: Mark.CURRENT})
    assert int(np.count_nonzero(pixels)) == 1
    assert mark_at(pixels, 11.0, 33.0) is Mark.CURRENT


@given(
    yaw_deg=st.floats(-180, 180),
    pitch_deg=st.floats(-90, 90),
    hfov_deg=st.floats(0.1, 170),
    vfov_deg=st.floats(0.1, 170),
    size=st.sampled_from([(72, 18), (48, 12), (36, 9)]),
)
def test_the_pixels_of_an_image_are_those_whose_centres_it_shows(
    yaw_deg: float, pitch_deg: float, hfov_deg: float, vfov_deg: float, size: tuple[int, int]
) -> None:
    width, height = size
    camera = Camera.from_fov(hfov_deg, vfov_deg)
    shot = a_shot(0, pitch_deg, yaw_deg)
    seen = np.array(a_map(camera, width=width, height=height).pixels([shot], {0: Mark.DONE})) == Mark.DONE
    elevation = np.radians(90.0 - 90.0 / height * (np.arange(2 * height) + 0.5))[:, None]
    azimuth = np.radians(-180.0 + 360.0 / width * (np.arange(width) + 0.5))[None, :]
    flat = np.cos(elevation)
    down = np.broadcast_to(-np.sin(elevation), (2 * height, width))
    ray = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), down], axis=-1) @ rotation(yaw_deg, pitch_deg)
    beyond = np.maximum(
        np.abs(ray[..., 1]) - camera.half_width * ray[..., 0], np.abs(ray[..., 2]) - camera.half_height * ray[..., 0]
    )
    inside, edge = (beyond <= 0) & (ray[..., 0] > 0), np.abs(beyond) < 1e-9
    extra = seen & ~inside & ~edge
    assert not (inside & ~seen & ~edge).any()
    assert np.count_nonzero(extra) <= 1, "the pixel of the boresight alone may be more"
    # no farther from the boresight than half a pixel's diagonal
    least = np.cos(np.hypot(np.pi / width, np.pi / 4 / height))
    assert (ray[..., 0][extra] >= least - 1e-9).all()


def shown(text: object, **console: object) -> str:
    out = Console(file=io.StringIO(), width=120, **console)  # type: ignore[arg-type]
    out.print(text)
    return out.file.getvalue()  # type: ignore[attr-defined,no-any-return]


def test_colours_and_their_legend() -> None:
    shots = [a_shot(0, 0.0, 0.0), a_shot(1, 0.0, 90.0)]
    text = a_map(CAMERA).text(shots, {0: Mark.DONE, 1: Mark.MISSING})
    coloured = shown(text, force_terminal=True, color_system="truecolor")
    for mark in (Mark.DONE, Mark.MISSING):
        red, green, blue = (int(LEGEND[mark][0][i : i + 2], 16) for i in (1, 3, 5))
        assert f"38;2;{red};{green};{blue}" in coloured
    assert "done 1  missing 1" in text.plain.replace("■ ", "")
    assert "to do" not in text.plain


def test_without_colours_the_characters_tell() -> None:
    shots = [a_shot(0, 0.0, 0.0), a_shot(1, 0.0, 90.0), a_shot(2, 0.0, -90.0)]
    plain = shown(a_map(CAMERA).text(shots, {0: Mark.DONE, 1: Mark.MISSING}, colours=False))
    lines = plain.splitlines()
    assert len(lines) == HEIGHT + CAPTIONS
    assert {"█", "x", "·"} <= set("".join(lines[:HEIGHT]))


@pytest.mark.parametrize("north", [True, False])
@pytest.mark.parametrize("size", [(72, 18), (48, 12), (36, 9)])
def test_azimuths_and_elevations_stand_where_they_are(size: tuple[int, int], north: bool) -> None:
    width, height = size
    shots = [a_shot(0, 30.0, 90.0)]
    sphere = a_map(Camera.from_fov(2.0, 1.5), width=width, height=height)
    lines = shown(sphere.text(shots, {0: Mark.MISSING}, colours=False, north=north)).splitlines()
    beside = {line[: MARGIN - 1].strip(): number for number, line in enumerate(lines[:height]) if line[:MARGIN].strip()}
    assert list(beside) == ["+60", "+30", "0°", "-30", "-60"]
    # an elevation stands in the line that begins there; the image is on that edge, where a map of few lines rounds
    (seen,) = (number for number, line in enumerate(lines[:height]) if "x" in line)
    assert abs(seen - beside["+30"]) <= 1
    azimuths = lines[height][MARGIN:]
    assert azimuths.split() == (["S", "W", "N", "E", "S"] if north else ["-180", "-90", "0°", "+90", "+180"])
    at = azimuths.index("E") if north else azimuths.index("+90") + 1
    assert abs(lines[seen][MARGIN:].index("x") - at) <= 1


@pytest.mark.parametrize(
    ("columns", "lines", "size"),
    [(120, 40, (72, 18)), (80, 24, (48, 12)), (75, 40, (48, 12)), (50, 24, (36, 9)), (39, 60, None), (80, 19, None)],
)
def test_the_map_is_as_large_as_there_is_room(columns: int, lines: int, size: tuple[int, int] | None) -> None:
    assert size_for(columns, lines, beside=9) == size


def test_the_marks_of_a_mission() -> None:
    shots = [a_shot(i, 0.0, 0.0) for i in range(7)]
    photo = ev.Photo(number=1, evidence=EvidenceLevel.COUNTED, capture_time_utc_s=0.0)

    def attempt(shot: int, number: int, *after: ev.Event) -> list[ev.Event]:
        started = ev.ShotStarted(shot=shot, attempt=number, round=0, pitch_deg=0.0, yaw_deg=0.0, patience_s=1.0)
        exposed = ev.ShotExposed(
            shot=shot,
            attempt=number,
            photos=(photo,),
            pointing_ok=True,
            reason="",
            samples=3,
            measured=None,
            errors=None,
            slew_settle_s=1.0,
            trigger_delay_s=0.0,
        )
        return [started, exposed, *after]

    def accepted(shot: int, number: int) -> ev.Event:
        return ev.ShotAccepted(shot=shot, attempt=number, photos=(photo,))

    def rejected(shot: int, number: int) -> ev.Event:
        return ev.ShotRejected(shot=shot, attempt=number, code="pointing", reason="off")

    happened: list[ev.Event] = [
        *attempt(0, 1, accepted(0, 1)),
        *attempt(1, 1, rejected(1, 1)),
        *attempt(1, 2, accepted(1, 2)),
        *attempt(2, 1, rejected(2, 1)),
        *attempt(3, 1, rejected(3, 1), ev.ShotMissed(shot=3, attempt=1, reason="off")),
        ev.ShotSkipped(shot=4, attempt=0),
        *attempt(5, 1),
    ]
    record = MissionRecord(mission_id="m", shots=shots)
    for seq, event in enumerate(happened, start=1):
        record.apply(ev.event_from_json(event.to_json() | {"seq": seq}))
    assert list(marks_of(record).values()) == [
        Mark.DONE,
        Mark.RETAKEN,
        Mark.AGAIN,
        Mark.MISSING,
        Mark.MISSING,
        Mark.CURRENT,
        Mark.PENDING,
    ]


def _flown(out: Console, *, live: bool = True) -> MissionView:
    """A whole mission under the view, its picture drawn at each event."""

    async def main() -> MissionView:
        async with a_world() as world:
            view = MissionView(live=live, out=out)
            view.expect(world.plan)
            mission = world.mission()
            with view:
                view.on_mission(mission)
                await _watched(world, mission, view)
            return view

    return run_virtual(main())


async def _watched(world: World, mission: Mission, view: MissionView) -> None:
    publish = world.sink.publish

    def also(event: ev.Event) -> None:
        publish(event)
        view.on_event(event)

    world.sink.publish = also  # type: ignore[method-assign]
    await mission.run()


def a_terminal(width: int, height: int) -> Console:
    return Console(
        file=io.StringIO(),
        force_terminal=True,
        color_system="truecolor",
        width=width,
        height=height,
        legacy_windows=False,
    )


def test_a_terminal_shows_the_map_above_the_bar() -> None:
    out = a_terminal(100, 40)
    _flown(out)
    text = out.file.getvalue()  # type: ignore[attr-defined]
    assert text.count("▀") >= WIDTH * HEIGHT
    assert "done 4" in text
    assert "4/4" in text


@pytest.mark.parametrize(("width", "height"), [(39, 40), (100, 15)])
def test_a_terminal_too_small_for_the_map_shows_the_bar_alone(width: int, height: int) -> None:
    out = a_terminal(width, height)
    _flown(out)
    text = out.file.getvalue()  # type: ignore[attr-defined]
    assert "▀" not in text
    assert "4/4" in text


def test_no_color_draws_with_characters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")  # https://no-color.org
    out = a_terminal(100, 40)
    _flown(out)
    text = out.file.getvalue()  # type: ignore[attr-defined]
    assert "▀" not in text
    assert text.count("█") >= WIDTH
    assert "█ done 4" in text


def test_programs_get_lines(capsys: pytest.CaptureFixture[str]) -> None:
    _flown(a_terminal(100, 40), live=False)
    err = capsys.readouterr().err
    assert err.count("accepted") == 4
    assert "▀" not in err
