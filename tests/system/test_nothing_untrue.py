"""Nothing accepted is untrue: whatever camera, gimbal and fault meet, each accepted photo is as its manifest says.

Missions over real UDP and MAVSDK, compared with the simulator's truth file. The suite flies a few combinations.
`PANOEXEC_NOTHING_UNTRUE=450` flies the first 450 of `kind_missions.missions` (seed 12): each kind of camera with each
kind of gimbal, and each of them with each fault; more than 450 adds triples, up to all of them.
`PANOEXEC_NOTHING_UNTRUE_SEED` draws others.
"""

from __future__ import annotations

import itertools
import os
from pathlib import Path

import pytest

pytest.importorskip("pymavlink")

from panoexec.sim.camera_kinds import CAMERA_KINDS
from panoexec.sim.faults import CONTENT_FAULTS, FAULTS
from panoexec.sim.gimbal_kinds import GIMBAL_KINDS
from tests.system.kind_missions import FAULT_ENDS, REFUSED_GIMBALS, Payload, fly, missions

SHORT = (
    Payload(camera="mavlink", gimbal="gremsy", autopilot="px4"),
    # the siblings of kinds that the simulator has as settings
    Payload(camera="mavlink", changes=("camera.silent_every=1", "camera.latency_s=1.2")),
    Payload(gimbal="siyi", fault="drift=0.5,x4", changes=("gimbal.report_age_s=1.0",)),
)
"""What the suite flies."""
COVERED = 450
"""So many of the missions make each pair meet."""
COUNT = int(os.environ.get("PANOEXEC_NOTHING_UNTRUE") or 0)
SEED = int(os.environ.get("PANOEXEC_NOTHING_UNTRUE_SEED") or 12)


@pytest.mark.parametrize("payload", [*SHORT, *itertools.islice(missions(SEED), COUNT)], ids=str)
async def test_nothing_accepted_is_untrue(tmp_path: Path, payload: Payload) -> None:
    flown = await fly(tmp_path, payload)
    assert flown.untrue == []
    summary = flown.summary
    assert summary.state == payload.end, summary.reason
    assert summary.reason, "every end has a cause"
    assert not (summary.state == "complete" and summary.missing)
    if payload.gimbal in REFUSED_GIMBALS:
        assert summary.accepted == 0


def test_the_missions_make_each_pair_meet_and_leave_no_combination_out() -> None:
    every = list(missions(12))
    assert len(every) == len(set(map(str, every)))
    assert {one.camera for one in every} == set(CAMERA_KINDS)
    assert {one.gimbal for one in every} == set(GIMBAL_KINDS)
    assert {one.fault.partition("=")[0] for one in every} == {"", *FAULTS} - CONTENT_FAULTS
    assert {fault.partition("=")[0] for fault in FAULT_ENDS} == FAULTS.keys() - CONTENT_FAULTS
    for first, second in itertools.combinations(("camera", "gimbal", "fault"), 2):
        met = {(getattr(one, first), getattr(one, second)) for one in every[:COVERED]}
        assert met == {(getattr(one, first), getattr(one, second)) for one in every}
