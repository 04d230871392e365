from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from panoexec.angles import direction, elevation_azimuth, rotation
from panoexec.formats.hugin_pto import (
    ControlPoint,
    PtoProject,
    parse_pto,
    point_arrays,
    pto_image,
    render_pto,
    turn_of_orientation,
)


def project(*poses: tuple[float, float, float], **changes: object) -> PtoProject:
    images = tuple(
        pto_image(f"images/DJI {k:04d}.JPG", 4000, 3000, rotation(y, p, r)) for k, (y, p, r) in enumerate(poses)
    )
    values: dict[str, object] = {"images": images, "hfov_deg": 60.0, "canvas_px": (20000, 10000)}
    return PtoProject(**{**values, **changes})  # type: ignore[arg-type]


angles = st.tuples(st.floats(-180, 179.9), st.floats(-91, 91), st.floats(-3, 3))


@given(poses=st.lists(angles, min_size=1, max_size=4))
@example(poses=[(30, -90, 0), (30, -90, 0.017), (-170, -89.99, -1), (10, -90.02, 0.01)])
def test_attitudes_survive_the_file(poses: list[tuple[float, float, float]]) -> None:
    back = parse_pto(render_pto(project(*poses)))
    for image, (yaw, pitch, roll) in zip(back.images, poses, strict=True):
        np.testing.assert_allclose(image.rotation, rotation(yaw, pitch, roll), atol=5e-9)


def test_everything_else_survives_the_file() -> None:
    made = project(
        (0, 0, 0),
        (30, 0, 0),
        crop_px=(0, 20000, 4000, 10000),
        lens={"b": -0.0125, "d": 3.5},
        control_points=(ControlPoint(first=0, second=1, x1=3000.25, y1=17.5, x2=1.0, y2=2999.0),),
        optimise=(("y", 1), ("p", 1), ("r", 1)),
    )
    back = parse_pto(render_pto(made))
    assert replace(back, images=()) == replace(made, images=())
    assert [image.file_name for image in back.images] == ["images/DJI 0000.JPG", "images/DJI 0001.JPG"]


def test_horizon_lines_are_not_control_points() -> None:
    text = render_pto(project((0, 0, 0), (30, 0, 0))) + "c n0 N0 x1 y2 X3 Y4 t2\n"
    assert parse_pto(text).control_points == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a Hugin project"),
        ("p f2 w100 h50 v360\n", "not a Hugin project"),
        ('p f0 w100 h50 v90\ni w10 h10 f0 v50 r0 p0 y0 n"a"\n', "equirectangular"),
        ('p f2 w100 h50 v360\ni w10 h10 f0 v50 r0 p0 n"a"\n', "invalid line"),
        ('p f2 w100 h50 v360\ni w10 h10 f0 r0 p0 y0 n"a"\n', "invalid line"),
    ],
)
def test_other_files_are_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_pto(text)


def test_names_that_would_break_the_file_are_refused() -> None:
    for name in ('a".jpg', "a\n.jpg"):
        bad = replace(project((0, 0, 0)), images=(pto_image(name, 10, 10, rotation(0, 0)),))
        with pytest.raises(ValueError, match="cannot be written"):
            render_pto(bad)
    with pytest.raises(ValueError, match="at least one image"):
        render_pto(replace(project((0, 0, 0)), images=()))


def test_rays_of_pixels() -> None:
    made = project((40, -20, 0), (0, 0, 90))
    # the middle of the image lies between pixels 1999 and 2000
    centre, right = made.rays([0, 0], [1999.5, 3999.5], [1499.5, 1499.5])
    np.testing.assert_allclose(centre, direction(-20, 40), atol=1e-12)
    assert np.degrees(np.arccos(centre @ right)) == pytest.approx(30.0, abs=1e-9)
    # rolled by 90° the image's right edge looks down
    elevation, _ = elevation_azimuth(made.rays([1], [3999.5], [1499.5]))
    assert elevation[0] == pytest.approx(-30.0, abs=1e-9)


def test_with_rotations_replaces_attitudes_only() -> None:
    made = project((40, -20, 0), (0, 0, 0))
    turned = made.with_rotations(rotation([1.0, 2.0], [3.0, -90.0], [0.5, 0.2]))
    np.testing.assert_allclose(turned.rotations(), rotation([1.0, 2.0], [3.0, -90.0], [0.5, 0.2]), atol=1e-9)
    assert [i.file_name for i in turned.images] == [i.file_name for i in made.images]


def test_turned_pixels() -> None:
    """A photo stored as 6 is turned clockwise to be viewed: its stored right edge is the scene's bottom."""
    assert [turn_of_orientation(o) for o in range(1, 9)] == [0, 0, 180, 0, 0, 90, 0, -90]
    image = pto_image("a.jpg", 4000, 3000, rotation(0, 0), turn_deg=turn_of_orientation(6))
    np.testing.assert_allclose(image.rotation @ [0, 1, 0], [0, 0, 1], atol=1e-12)


def test_point_arrays() -> None:
    points = (ControlPoint(first=0, second=1, x1=1, y1=2, x2=3, y2=4),)
    numbers, pixels = point_arrays(points)
    assert numbers.tolist() == [[0, 1]]
    assert pixels.tolist() == [[1, 2, 3, 4]]
    assert point_arrays(())[0].shape == (0, 2)
