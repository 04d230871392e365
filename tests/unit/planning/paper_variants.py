"""The paper's algorithms at their most literal, and with enough margin for our guarantees: what we compare with."""

from __future__ import annotations

import math
from dataclasses import replace

from panoexec.optics import Camera
from panoexec.planning.baselines.grid import Row, evenly_spaced, shots_by_row
from panoexec.planning.baselines.paper import pan_step_deg, plan_paper, tilt_step_deg
from panoexec.planning.certificate.verdict import certify
from panoexec.planning.model import Constraints, Plan


def literal_plan(camera: Camera, constraints: Constraints, top_pitch_deg: float) -> Plan:
    """Algorithms 1 and 2 word for word from a given first row down to the nadir, gaps and all."""
    step = tilt_step_deg(camera, constraints.overlap_v)
    rows: list[Row] = []
    pitch = top_pitch_deg
    while pitch > -90.0:
        count = math.ceil(360.0 / pan_step_deg(camera, pitch, constraints.overlap_h) - 1e-9)
        rows.append(evenly_spaced(pitch, count, constraints.band))
        pitch -= step
    rows.append(evenly_spaced(-90.0, 1, constraints.band))
    return Plan(method="paper", camera=camera, constraints=constraints, shots=shots_by_row(rows, constraints.band))


def guaranteed_plan(camera: Camera, constraints: Constraints) -> Plan | None:
    """The least that the paper's planner needs to be certified: planned for images smaller than they are.

    The image's borders are drawn in by ever more until the certificate holds for the real image.

    Returns:
        The certified plan with the fewest images that was found, or None.
    """
    best: Plan | None = None
    since = 0
    for shrink in (0.005 * i for i in range(90)):
        smaller = replace(
            camera,
            sensor_width_mm=camera.sensor_width_mm * (1 - shrink),
            sensor_height_mm=camera.sensor_height_mm * (1 - shrink),
        )
        plan = replace(plan_paper(smaller, constraints), camera=camera)
        since += best is not None
        if best is None or len(plan.shots) < len(best.shots):
            certificate = certify(plan)
            if certificate.certified:
                best, since = replace(plan, certificate=certificate), 0
        # counts rise with the margin, up to a few images that the row of caps saves
        if since > 6:
            break
    return best
