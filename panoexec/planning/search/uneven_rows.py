"""Plans with fewer images than rows of even images allow: rows that lack a little, made to hold image by image.

The row search is repeated with a negative margin: rows of these counts lack overlap or coverage if their images are
even. `pose_fit` moves single images until nothing is lacking. Images of a row then differ in pitch by a degree or so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from panoexec.angles import wrap_180
from panoexec.optics import Camera
from panoexec.planning.certificate.adjacency import MUTUAL_OVERLAP
from panoexec.planning.model import Constraints, Shot
from panoexec.planning.search.budget import SearchBudget
from panoexec.planning.search.pose_fit import Poses, fit_poses
from panoexec.planning.search.row_constraints import RowConstraints
from panoexec.planning.search.row_refinement import Rows, refine
from panoexec.planning.search.row_search import RowSearch
from panoexec.planning.search.variants import variants

_LACK, _LITTLE_LACK = 0.035, 0.012
"""Margin that even rows may lack, see `PairMargin`; and that with which their images begin, if they reach all round."""

_WIDTH = 8
"""Beam width of the search for such rows."""

_MOST_IMAGES = 200
"""Plans of more images are not improved so: a step costs more than an image is worth."""

_STEPS, _LEAST_STEPS = 24, 6
_WORK, _PER_STEP = 2500, 30
"""What all tries together may take, and each step of one in addition to its images."""

_DECIMALS = 7


def uneven_rows(
    camera: Camera, constraints: Constraints, images: Callable[[], int], *, enough: int, budget: SearchBudget
) -> Iterator[tuple[Shot, ...]]:
    """Proposals of fewer images than the best plan has, row by row; only the certificate knows whether they hold.

    They are for full circles without masks and skyline whose C2 and C3 hold at the planned poses, if the gimbal pans
    all round; else there are none.

    Args:
        camera: the camera.
        constraints: what is asked for.
        images: the number of images of the best plan so far.
        enough: the fewest images that are looked for.
        budget: of the search.

    Raises:
        BudgetSpentError: the budget is used up.
    """
    rules = RowConstraints(camera, constraints, next(variants(camera, constraints)).demands, budget=budget)
    if not _applies(constraints, rules) or images() > _MOST_IMAGES:
        return
    left, tried = _WORK, set[tuple[int, ...]]()
    if images() <= enough:
        return
    labels = RowSearch(rules, wanted=-_LACK, width=_WIDTH).solutions(retry=False, fewer_than=images())
    # those of the most images lack the least
    for label in sorted(labels, key=lambda label: -label.images):
        counts = tuple(count for _, count in label.path())
        if not enough <= label.images < images() or counts in tried:
            continue
        tried.add(counts)
        rows = refine(rules, label.path(), -_LITTLE_LACK) or refine(rules, label.path(), -_LACK)
        if rows is None:
            continue
        steps = min(left // (label.images + _PER_STEP), _STEPS)
        if steps < _LEAST_STEPS:
            return
        before = budget.work
        start = _start(rules, rows)
        poses = fit_poses(camera, constraints, start, pitch_deg=rules.pitch_deg, steps=steps, budget=budget)
        left -= (budget.work - before) // label.images * (label.images + _PER_STEP)
        if poses is not None:
            yield _shots(poses)


def _applies(constraints: Constraints, rules: RowConstraints) -> bool:
    return (
        rules.layout.is_even
        and not constraints.masks
        and constraints.textured_below is None
        and constraints.guarantee == "coverage"
        and min(constraints.overlap_h, constraints.overlap_v) >= MUTUAL_OVERLAP
    )


def _start(rules: RowConstraints, rows: Rows) -> Poses:
    each = zip(rows.pitch_deg, rows.count, rows.phase_deg, strict=True)
    return Poses(
        np.concatenate([rules.layout.yaws_deg(pitch, count, phase) for pitch, count, phase in each]),
        np.repeat(rows.pitch_deg, rows.count),
        np.repeat(np.arange(len(rows.count)), rows.count),
    )


def _shots(poses: Poses) -> tuple[Shot, ...]:
    yaws = np.round(wrap_180(poses.yaw_deg), _DECIMALS)
    yaws[yaws >= 180.0] = -180.0
    each = zip(poses.rows.tolist(), np.round(poses.pitch_deg, _DECIMALS).tolist(), yaws.tolist(), strict=True)
    return tuple(Shot(index=k, row=row, pitch_deg=pitch, yaw_deg=yaw) for k, (row, pitch, yaw) in enumerate(each))
