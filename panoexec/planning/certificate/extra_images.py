"""Images beyond those that make a plan complete: they must not make it fail.

C2 and C3 speak of rows. An image between two rows, say one straight ahead, is a row of its own by its pitch, and the
rows beside it would have to overlap with it alone; an image beside a sector has no neighbour. Nothing is lost by such
images: **a plan is certified if some of its images, in rows, satisfy C1 to C4 by themselves.** The others only add
photos. This is sound, as the proof is that of the part, which does not mention the others.

Which images are left out is searched here, a few at a time, among those that make a condition fail; the certificate of
the rest decides. So a plan that fails may have a part that would not, but no plan passes without a part that does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from panoexec.planning.model import Certificate, Constraints

MOST_LEFT_OUT = 6
"""Steps of the search; each leaves out an image, or a row of one or two."""

_WORK = 6_000
"""Images certified in the search."""

_SMALL_ROW = 2

Certify = Callable[[Sequence[int]], Certificate]
"""The certificate of some of the images, which it names by their position among these."""


def certified_part(
    whole: Certificate,
    rows: Sequence[int],
    constraints: Constraints,
    certify_some: Certify,
    go_on: Callable[[], bool] = lambda: True,
) -> Certificate | None:
    """The certificate of a part of the images that is certified, None if none is found.

    Args:
        whole: the certificate of all images, which fails.
        rows: (n,) row number of each image.
        constraints: what the plan must satisfy.
        certify_some: certifies the images of these indices.
        go_on: asked before each of these certificates; False ends the search.

    Returns:
        The certificate of the part, with `images` of the whole, and images named by their position in the whole.
    """
    if whole.uncovered_fraction > 0:
        return None  # fewer images do not cover more
    kept, judged, work = list(range(len(rows))), whole, 0
    for _ in range(MOST_LEFT_OUT):
        best: tuple[tuple[float, ...], list[int], Certificate] | None = None
        for left_out in _suspects(judged, kept, rows):
            rest = [i for i in kept if i not in left_out]
            work += len(rest)
            if not rest or work > _WORK or not go_on():
                return None
            found = _renamed(certify_some(rest), rest)
            if found.certified:
                return replace(found, images=len(rows))
            rank = (found.uncovered_fraction, len(found.failures), _missing(found, constraints), len(left_out))
            if best is None or rank < best[0]:
                best = rank, rest, found
        if best is None or best[2].uncovered_fraction > 0:
            return None
        _, kept, judged = best
    return None


def _suspects(judged: Certificate, kept: Sequence[int], rows: Sequence[int]) -> Iterator[set[int]]:
    """Sets of images that may make a condition fail: small rows, and the images with the smallest overlaps."""
    members: dict[int, set[int]] = {}
    for i in kept:
        members.setdefault(rows[i], set()).add(i)
    seen: list[set[int]] = []
    single = [*(judged.weakest_h or ()), *(image for edge in judged.bridges[:2] for image in edge)]
    single += [] if judged.weakest_v is None else [judged.weakest_v]
    for some in [*({image} for image in single), *(row for row in members.values() if len(row) <= _SMALL_ROW)]:
        if some not in seen:
            seen.append(some)
            yield some


def _missing(certificate: Certificate, constraints: Constraints) -> float:
    """By how much C2 and C3 fail together."""
    every = constraints.guarantee == "all"
    across = certificate.worst_overlap_h if every else certificate.min_overlap_h
    upwards = certificate.worst_overlap_v if every else certificate.min_overlap_v
    return sum(
        max(asked - (asked if least is None else least), 0.0)
        for asked, least in ((constraints.overlap_h, across), (constraints.overlap_v, upwards))
    )


def _renamed(certificate: Certificate, names: Sequence[int]) -> Certificate:
    pair, image = certificate.weakest_h, certificate.weakest_v
    return replace(
        certificate,
        weakest_h=None if pair is None else (names[pair[0]], names[pair[1]]),
        weakest_v=None if image is None else names[image],
        bridges=tuple((names[a], names[b]) for a, b in certificate.bridges),
    )
