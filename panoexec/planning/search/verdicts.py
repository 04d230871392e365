"""Verdicts of the certificate on proposals, each begun only if the budget has time for it."""

from __future__ import annotations

from collections.abc import Sequence

from panoexec.optics import Camera
from panoexec.planning.model import Certificate, Constraints, Shot
from panoexec.planning.search.budget import SearchBudget
from panoexec.planning.search.proposal import verdict

_VERDICT_S_PER_IMAGE, _FEW_IMAGES = 1e-3, 100
"""Processor time of a verdict for each image before any was measured, as for so many images at least."""

_ORDER_S, _ORDER_S_PER_IMAGE = 0.1, 1e-3
"""Processor time of ordering the shots, more than was measured."""

_EXPLAINING = 3
"""A certificate that explains what fails takes as long as so many verdicts, at most."""


class TimedVerdicts:
    """Verdicts on the proposals of one search, and by these how long others take.

    Args:
        camera: the camera.
        budget: of the search.
    """

    def __init__(self, camera: Camera, budget: SearchBudget) -> None:
        self._camera = camera
        self._budget = budget
        self._image_s = _VERDICT_S_PER_IMAGE

    def on(self, constraints: Constraints, shots: Sequence[Shot]) -> Certificate:
        """The certificate of shots, without an explanation of holes.

        Raises:
            BudgetSpentError: there is no time for it.
        """
        self._budget.use(seconds=self.one_s(len(shots)))
        began = self._budget.clock()
        certificate = verdict(self._camera, constraints, shots)
        self._image_s = max(self._image_s, (self._budget.clock() - began) / max(len(shots), _FEW_IMAGES))
        return certificate

    def one_s(self, images: int) -> float:
        """About how long a verdict on so many images takes, by those before, seconds of processor time."""
        return self._image_s * max(images, _FEW_IMAGES)

    def explaining_s(self, images: int) -> float:
        """About how long it takes to order images and to explain what fails, seconds of processor time."""
        return ordering_s(images) + _EXPLAINING * self.one_s(images)


def ordering_s(images: int) -> float:
    """About how long ordering the shots takes, seconds of processor time."""
    return _ORDER_S + _ORDER_S_PER_IMAGE * images
