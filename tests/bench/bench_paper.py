"""How many images the paper's scenarios need: as published, by the paper's algorithms, with our guarantees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from panoexec.planning.baselines.paper import plan_paper
from panoexec.planning.baselines.published import PUBLISHED, published_plan
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import NO_TOLERANCE
from tests.bench.harness import Measurement
from tests.unit.planning.paper_variants import guaranteed_plan, literal_plan


def measure() -> Iterator[Measurement]:
    """For each scenario: published, word for word, `--method paper`, and what that needs to be certified."""
    for name in ("scenario-1-proposed", "scenario-2-proposed", "scenario-3-proposed"):
        published = published_plan(name)
        camera, constraints = published.camera, published.constraints
        top_pitch = -min(PUBLISHED[name].images_by_tilt)
        count = len(published.shots)
        literal = literal_plan(camera, replace(constraints, tolerance=NO_TOLERANCE), top_pitch)
        holes = len(certify(literal).holes)
        yield _images(
            name, f"Algorithms 1 and 2 word for word ({holes} holes at the planned poses)", len(literal.shots), count
        )
        yield _images(
            name, "--method paper, complete at the planned poses", len(plan_paper(camera, constraints).shots), count
        )
        guaranteed = guaranteed_plan(camera, constraints)
        if guaranteed is not None:
            yield _images(name, "--method paper with margins until certified", len(guaranteed.shots), count)


def _images(name: str, what: str, images: int, published: int) -> Measurement:
    return Measurement(what=f"{name}, {what}", ours=images, unit="images", peer="published", theirs=published)
