"""Examines photos one by one as they arrive, and keeps what it needs to tie later ones to them."""

from __future__ import annotations

import hashlib
import io
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import PIL.Image

from panoexec.angles import FloatArray
from panoexec.optics import Camera
from panoexec.pictures.bridging import Bank, bridge_poses
from panoexec.pictures.decoding import UnreadableError, decode
from panoexec.pictures.features import DISTINCT_CORNER, Exposure, Features, features_of
from panoexec.pictures.judgement import Limits, Pair, Subject, judge
from panoexec.pictures.lens import LensFit, fit_lens
from panoexec.pictures.matching import SEARCH_DEG, Tie, View, tie
from panoexec.pictures.model import BAD, BridgePose, Content, PhotoToCheck, Verdicts
from panoexec.pictures.straighten import stored_pixels, straightened
from panoexec.planning.geometry.overlap import pairwise_overlap

EXAMINED_PX: Final = 1000
"""Longer side at which photos are examined."""
LEAST_PX: Final = 240
"""Longer side below which nothing is examined but whether the file can be read."""
MIN_OVERLAP: Final = 0.03
"""Least overlap, both ways, of photos that are compared."""
_RATIOS: Final = (1.0, 0.99, 1.01, 0.98, 1.02, 0.97, 1.03)
"""Focal lengths that are tried with the first photos, as shares of the nominal one: stated ones are rounded."""
_GUESS_PAIRS, _MOST_GUESS_PAIRS = 2, 3
_GUESS_CORNERS: Final = 20
_BETTER: Final = 1.15
"""How much better than the nominal focal length another one has to be."""
_WELL_FRAC, _WELL_PX = 0.8, 0.2
"""Share of the corners, and residual, with which the nominal focal length is good enough to begin with."""
_FITTED_AT: Final = frozenset({4, 6, 9, 14, 24, 48})
"""Numbers of photos with which the focal length is fitted."""
_FOCAL_STEP: Final = 0.0015
"""A smaller change of the focal length is not worth tying all photos anew."""
_BLACK, _WHITE = 10.0, 250.0
_IN_MEMORY: Final = 48
"""Photos whose pixels are kept as they are; those of older ones are kept as JPEGs."""


@dataclass(slots=True)
class _Photo:
    photo: PhotoToCheck
    features: Features | None = None
    packed: bytes = b""
    problem: tuple[Content, str] | None = None
    digest: bytes = b""
    used: int = 0
    size: tuple[int, int] | None = None


class Examiner:
    """The photos of one mission.

    Args:
        camera: its optics; the field of view counts, not the number of pixels.
        planned: planned attitude (3, 3) of each shot, from which its neighbours are known before they are taken.
        limits: what is a good photo.
        longer_px: the longer side at which photos are examined.
        search_deg: how far apart from the measured attitudes ties are searched.
    """

    def __init__(
        self,
        camera: Camera,
        planned: Mapping[int, FloatArray] | None = None,
        *,
        limits: Limits | None = None,
        longer_px: int = EXAMINED_PX,
        search_deg: float = SEARCH_DEG,
    ) -> None:
        self._camera = camera
        self._limits = limits or Limits()
        self._longer_px = longer_px
        self._search_deg = search_deg
        self._photos: dict[int, _Photo] = {}
        self._ties: dict[Pair, Tie] = {}
        self._planned: dict[int, FloatArray] = {}
        self._expected: dict[int, frozenset[int]] = {}
        self._size: tuple[int, int] | None = None
        self._sizes: Counter[tuple[int, int]] = Counter()
        self._uses = 0
        self._focal_ratio = 1.0
        self._guessed = False
        self.plan(planned or {})

    def plan(self, planned: Mapping[int, FloatArray]) -> None:
        """Add planned shots."""
        self._planned.update(planned)
        shots = sorted(self._planned)
        if not shots:
            return
        rotations = np.array([self._planned[shot] for shot in shots])
        for number, shot in enumerate(shots):
            shared = self._overlaps(rotations[number], rotations)
            near = {other for other, value in zip(shots, shared, strict=True) if value >= MIN_OVERLAP}
            self._expected[shot] = frozenset(near - {shot})

    def drop(self, shot: int) -> None:
        """Forget a photo, or a planned shot that will not be taken."""
        self._photos.pop(shot, None)
        for pair in [pair for pair in self._ties if shot in pair]:
            del self._ties[pair]

    def forget_plan(self, shot: int) -> None:
        """No photo of this shot is to come."""
        self._planned.pop(shot, None)
        self._expected.pop(shot, None)
        self._expected = {own: others - {shot} for own, others in self._expected.items()}

    @property
    def ties(self) -> Mapping[Pair, Tie]:
        """Results by pairs of shots, the lower number first."""
        return self._ties

    def focal_px(self) -> float:
        """Focal length that counts at the scale of the examination; NaN before the first readable photo."""
        for photo in self._photos.values():
            if photo.features is not None and photo.size == self._size:
                return photo.features.size[0] / (2 * self._camera.pinhole_half_width)
        return float("nan")

    def size_px(self) -> tuple[int, int] | None:
        """Width and height at the scale of the examination."""
        photos = (photo for photo in self._photos.values() if photo.size == self._size)
        return next((photo.features.size for photo in photos if photo.features is not None), None)

    def add(self, photo: PhotoToCheck, content: bytes) -> None:
        """Examine a photo; it replaces an earlier one of the same shot.

        Args:
            photo: which one, and its attitude.
            content: of its file.
        """
        self.drop(photo.shot)
        own = _Photo(photo)
        self._photos[photo.shot] = own
        try:
            decoded = decode(content, self._longer_px)
        except UnreadableError as error:
            own.problem = (Content.UNREADABLE, str(error))
            return
        own.size = size = (decoded.width_px, decoded.height_px)
        self._sizes[size] += 1
        before, self._size = self._size, self._usual_size()
        if max(decoded.grey.shape) < LEAST_PX:
            own.problem = (Content.UNCHECKED, f"{size[0]} x {size[1]} px are too few to be examined")
            return
        grey = straightened(decoded.grey, self._camera)
        features = features_of(grey)
        own.problem = _own_exposure(features.exposure)
        own.digest = hashlib.sha256(decoded.grey.tobytes()).digest()
        own.features = features
        if self._size not in (before, None):  # what was compared so far was of the odd size
            self._ties.clear()
            photos = list(self._photos.values())
            for number, one in enumerate(photos):
                self._tie(one, photos[:number])
        else:
            self._tie(own, self._photos.values())
        self._calibrate()
        self._make_room()

    def _usual_size(self) -> tuple[int, int]:
        """The size of whole photos: that of the profile if any has it, else that of most so far, dropped ones too."""
        whole = (self._camera.image_width_px, self._camera.image_height_px)
        return whole if whole in self._sizes else max(self._sizes, key=self._sizes.__getitem__)

    def _problem_of(self, own: _Photo) -> tuple[Content, str] | None:
        if own.size is None or self._size is None or own.size == self._size:
            return own.problem
        (width, height), (usual_width, usual_height) = own.size, self._size
        text = f"is {width} x {height} px, the others {usual_width} x {usual_height} px"
        return Content.UNREADABLE, text

    def condemn(self, photo: PhotoToCheck, code: str, reason: str) -> None:
        """Add a photo that is bad for a reason that others found; it replaces an earlier one of the same shot."""
        self.drop(photo.shot)
        self._photos[photo.shot] = _Photo(photo, problem=(Content(code), reason))

    def verdicts(self, *, final: bool = False) -> Verdicts:
        """Judge all photos so far.

        Args:
            final: no more photos are to come.
        """
        first: dict[bytes, int] = {}
        subjects = []
        by_time = sorted(self._photos.values(), key=lambda own: (own.photo.time_s, own.photo.shot))
        for own in by_time:
            same = first.get(own.digest) if own.digest and own.problem is None else None
            if own.digest and own.problem is None and same is None:
                first[own.digest] = own.photo.shot
            subjects.append(
                Subject(
                    shot=own.photo.shot,
                    time_s=own.photo.time_s,
                    rotation=own.photo.rotation,
                    problem=self._problem_of(own),
                    same_as=same,
                    expected=self._expected.get(own.photo.shot, frozenset()),
                )
            )
        return judge(subjects, self._ties, self._limits, final=final)

    def bridges(
        self,
        *,
        tried: Collection[frozenset[int]] = (),
        pitch_deg: tuple[float, float] = (-90.0, 90.0),
        most: int,
    ) -> list[BridgePose]:
        """Poses that may tie photos which share too little: `bridging.bridge_poses`, whose arguments these are."""
        verdicts = self.verdicts(final=True)
        group = {shot: number for number, shots in enumerate(verdicts.graph.groups) for shot in shots}
        banks = {}
        for number, (shot, own) in enumerate(self._photos.items()):
            verdict = verdicts.photos[shot].verdict
            if own.features is None or (verdict in BAD and verdict is not Content.UNTIED):
                continue
            features = own.features
            width, height = features.size
            places = features.corners[features.strength >= DISTINCT_CORNER]
            centre = np.array([(width - 1) / 2, (height - 1) / 2])
            focal = np.full((len(places), 1), width / (2 * self._camera.pinhole_half_width))
            rays = np.concatenate([focal, places - centre], axis=1)
            # an untied photo is a group of its own
            banks[shot] = Bank(rotation=own.photo.rotation, rays=rays, group=group.get(shot, -1 - number))
        return bridge_poses(self._camera, banks, tried=tried, pitch_deg=pitch_deg, most=most)

    def _is_comparable(self, one: _Photo) -> bool:
        return one.features is not None and self._problem_of(one) is None

    def _tie(self, own: _Photo, photos: Iterable[_Photo]) -> None:
        others = [other for other in photos if other is not own and self._is_comparable(other)]
        if not others or not self._is_comparable(own):
            return
        shared = self._overlaps(own.photo.rotation, np.array([other.photo.rotation for other in others]))
        for other, value in zip(others, shared, strict=True):
            if value < MIN_OVERLAP:
                continue
            first, second = (own, other) if own.photo.shot < other.photo.shot else (other, own)
            result = tie(self._view(first), self._view(second), search_deg=self._search_deg)
            if result is not None:
                self._ties[first.photo.shot, second.photo.shot] = result

    # --- the focal length

    def lens(self) -> LensFit | None:
        """The whole lens as the agreeing ties see it, relative to the stated focal length; None with few points."""
        size = self.size_px()
        if size is None:
            return None
        bad = {found.shot for found in self.verdicts(final=True).bad}
        stored = {
            pair: replace(tie, pixels=stored_pixels(tie.pixels.reshape(-1, 2, 2), self._camera, size).reshape(-1, 4))
            for pair, tie in self._ties.items()
            if not bad & set(pair)
        }
        return self._fitted(stored, self.focal_px())

    def _fitted(self, ties: Mapping[Pair, Tie], focal_px: float) -> LensFit | None:
        width, height = self.size_px() or (1, 1)
        rotations = {shot: own.photo.rotation for shot, own in self._photos.items()}
        return fit_lens(ties, rotations, focal_px=focal_px, centre=np.array([(width - 1) / 2, (height - 1) / 2]))

    def _calibrate(self) -> None:
        """Find the focal length with the first photos, and again with some more: one that is 1 % off ties less."""
        if not self._guessed:
            self._guess()
        readable = sum(own.features is not None for own in self._photos.values())
        if readable not in _FITTED_AT:
            return
        fit = self._fitted(self._ties, self.focal_px() * self._focal_ratio)
        if fit is not None and fit.focal_sigma < _FOCAL_STEP and abs(fit.focal_ratio - 1) > _FOCAL_STEP:
            self._retie(self._focal_ratio * fit.focal_ratio)

    def _guess(self) -> None:
        pairs = [pair for pair, tie in self._ties.items() if tie.textured and tie.searched >= _GUESS_CORNERS]
        if len(pairs) < _GUESS_PAIRS:
            return
        self._guessed = True
        # a bad photo among the first ones tells nothing
        pairs = sorted(pairs, key=lambda pair: -self._ties[pair].points)[:_MOST_GUESS_PAIRS]
        ties = [self._ties[pair] for pair in pairs]
        if all(one.points >= _WELL_FRAC * one.searched and one.rms_px <= _WELL_PX for one in ties):
            return
        scores = []
        for ratio in _RATIOS:
            self._focal_ratio = ratio
            found = [
                tie(*(self._view(self._photos[shot]) for shot in pair), search_deg=self._search_deg) for pair in pairs
            ]
            # as many corners as possible, as exactly as possible
            scores.append(sum(one.points / max(one.rms_px, 0.1) for one in found if one is not None and one.tied))
        best = int(np.argmax(scores))
        self._focal_ratio = 1.0
        if scores[best] > _BETTER * scores[0]:
            self._retie(_RATIOS[best])

    def _retie(self, ratio: float) -> None:
        self._focal_ratio = ratio
        for a, b in list(self._ties):
            result = tie(self._view(self._photos[a]), self._view(self._photos[b]), search_deg=self._search_deg)
            if result is not None:
                self._ties[a, b] = result

    def _view(self, own: _Photo) -> View:
        assert own.features is not None
        self._uses += 1
        own.used = self._uses
        if own.packed:
            grey = np.asarray(PIL.Image.open(io.BytesIO(own.packed)))
            own.features, own.packed = replace(own.features, grey=grey), b""
        focal = self._focal_ratio * own.features.size[0] / (2 * self._camera.pinhole_half_width)
        return View(features=own.features, rotation=own.photo.rotation, focal_px=focal, place=own.photo.place)

    def _make_room(self) -> None:
        """Keep the pixels of the photos that were used last; the others' as JPEGs."""
        whole = [own for own in self._photos.values() if own.features is not None and not own.packed]
        for own in sorted(whole, key=lambda own: own.used)[: max(0, len(whole) - _IN_MEMORY)]:
            assert own.features is not None
            buffer = io.BytesIO()
            PIL.Image.fromarray(own.features.grey).save(buffer, "JPEG", quality=93)
            own.packed = buffer.getvalue()
            own.features = replace(own.features, grey=np.empty((0, own.features.size[0]), dtype=np.uint8))

    def _overlaps(self, rotation: FloatArray, others: FloatArray) -> FloatArray:
        """Mutual overlap of one photo with others, (n,)."""
        there = pairwise_overlap(self._camera, rotation[None], others)
        back = pairwise_overlap(self._camera, others, rotation[None])
        return np.minimum(there, back)


def _own_exposure(exposure: Exposure) -> tuple[Content, str] | None:
    if exposure.high <= _BLACK:
        return Content.EXPOSURE, f"black: 99 % of its pixels are at most {exposure.high:.0f} of 255"
    if exposure.low >= _WHITE:
        return Content.EXPOSURE, f"white: 99 % of its pixels are at least {exposure.low:.0f} of 255"
    return None
