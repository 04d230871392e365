"""The lower bounds of one request, each computed when it is first needed, and no farther than it is needed."""

from __future__ import annotations

from functools import cached_property

from panoexec.optics import Camera
from panoexec.planning.model import Constraints
from panoexec.planning.search.budget import SearchBudget
from panoexec.planning.search.lower_bound import least_images
from panoexec.planning.search.row_bound import least_images_in_rows


class LowerBounds:
    """The bounds of the number of images.

    Args:
        camera: the camera.
        constraints: the request.
        budget: of the search, which what is computed here takes part of.
    """

    def __init__(self, camera: Camera, constraints: Constraints, budget: SearchBudget) -> None:
        self._camera = camera
        self._constraints = constraints
        self._budget = budget
        self._in_rows: int | None = None

    @cached_property
    def of_any(self) -> int:
        """No plan has fewer images."""
        return least_images(self._camera, self._constraints)

    def in_rows(self, images: int | None, *, after_s: float | None = None) -> int:
        """No plan in even rows has fewer images.

        Args:
            images: the number of images of such a plan, beyond which nothing is looked for; None for none. The first
                call decides.
            after_s: processor time that must be left, seconds; None for what the budget reserves. With less, the bound
                is not as tight as it could be.
        """

        def go_on() -> bool:
            return not self._budget.spent if after_s is None else self._budget.left > after_s

        if self._in_rows is None:
            least = self.of_any
            if images is None or least < images:
                found = least_images_in_rows(self._camera, self._constraints, images=images, go_on=go_on)
                least = max(least, found or 1)
            self._in_rows = least
        return self._in_rows
