"""A gust between the trigger and the opening of the shutter harms no photo, if the opening is proven."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from panoexec.mission.log import events as ev
from panoexec.mission.log.states import MissionState
from tests.unit.fakes.flying import fly
from tests.unit.fakes.world import TOLERANCE, World, a_plan, some_settings

LATENCY_S, EXPOSURE_S, REPORT_S = 0.1, 0.02, 0.05
NEAR_DEG = TOLERANCE.pitch_deg + 0.6 * min(0.25 * TOLERANCE.pitch_deg, 0.05)
"""Out of tolerance, by less than may be while the shutter is closed."""
FAR_DEG = TOLERANCE.pitch_deg + 1.5 * min(0.25 * TOLERANCE.pitch_deg, 0.05)
BEFORE, DURING = (0.02, 0.06), (LATENCY_S - 0.01, LATENCY_S + EXPOSURE_S + 0.01)
CALM = 4
"""Photos before the gusts begin, where nothing else is said."""


def gusts(
    world: World,
    *,
    pitch_deg: float,
    span_s: tuple[float, float],
    stamps_s: float,
    irregular_s: float = 0.0,
    calm: int = CALM,
) -> None:
    """After some calm photos, a gust after each trigger until a photo was rejected or revoked."""
    camera, gimbal = world.camera, world.gimbal
    camera.latency_s, camera.exposure_s, camera.proof_after_s = LATENCY_S, EXPOSURE_S, REPORT_S
    camera.dates, camera.stamps_s = True, stamps_s
    gimbal.rate_hz = 50.0

    def drift(at_s: float) -> tuple[float, float, float]:
        camera.latency_s = LATENCY_S + irregular_s * (len(camera.photos) % 3)
        over = world.sink.of(ev.ShotRejected) or world.sink.of(ev.ShotRevoked)
        if len(camera.photos) <= calm or over:
            return 0.0, 0.0, 0.0
        since_s = at_s - camera.photos[-1].triggered_s
        return 0.0, pitch_deg if span_s[0] <= since_s <= span_s[1] else 0.0, 0.0

    gimbal.drift = drift


def flown(prepare: Callable[[World], None]) -> World:
    """A mission, whose accepted photos were all taken in tolerance by the fakes' truth."""
    settings = some_settings(latency_s=0.15, exposure_s=EXPOSURE_S)
    world = fly(prepare=prepare, plan=a_plan(8), settings=settings)
    assert world.record.state is MissionState.COMPLETE
    return world


def test_a_gust_before_the_proven_opening_costs_no_photo_and_is_told() -> None:
    world = flown(lambda w: gusts(w, pitch_deg=NEAR_DEG, span_s=BEFORE, stamps_s=0.0))
    assert not world.sink.of(ev.ShotRejected)
    reasons = [attempt.reason for shot in world.record.shots.values() for attempt in shot.attempts]
    told = [reason for reason in reasons if reason]
    assert len(told) == 8 - CALM
    assert [event.proof for event in world.sink.of(ev.ShotExposed)] == ["samples"] * CALM + ["opening"] * (8 - CALM)
    assert all(
        reason.startswith("pitch off by +0.1") and reason.endswith("while the shutter was closed") for reason in told
    )


def test_noise_that_takes_single_samples_out_of_tolerance_is_told_as_what_it_is() -> None:
    """The record has the errors of the curve that proves the pose, and says that it does."""

    def prepare(world: World) -> None:
        gusts(world, pitch_deg=0.0, span_s=BEFORE, stamps_s=0.0)
        world.gimbal.rate_hz, world.gimbal.noise_deg = 100.0, 0.02
        world.gimbal.drift = lambda at_s: (0.0, 0.062 if len(world.camera.photos) > CALM else 0.0, 0.0)

    world = flown(prepare)
    proofs: dict[str, int] = {}
    for event in world.sink.of(ev.ShotExposed):
        if not event.pointing_ok:
            assert event.proof == ""
            continue
        assert event.errors is not None
        assert abs(event.errors.pitch_deg) <= TOLERANCE.pitch_deg
        proofs[event.proof] = proofs.get(event.proof, 0) + 1
        assert ("prove the pose" in event.reason) is (event.proof == "curve")
    assert proofs["samples"] >= CALM
    assert proofs["curve"] >= 1


def test_a_shutter_that_turns_out_irregular_costs_what_was_accepted_by_its_stamps() -> None:
    world = flown(lambda w: gusts(w, pitch_deg=NEAR_DEG, span_s=BEFORE, stamps_s=0.0, irregular_s=0.04, calm=0))
    revoked = world.sink.of(ev.ShotRevoked)
    assert revoked
    assert {event.code for event in revoked} == {"late_exposure"}
    assert "the camera's stamps are irregular" in revoked[0].reason
    accepted = [shot.accepted for shot in world.record.shots.values()]
    assert not any(attempt.reason for attempt in accepted if attempt is not None)


@pytest.mark.parametrize(
    ("pitch_deg", "span_s", "stamps_s", "irregular_s"),
    [
        pytest.param(NEAR_DEG, DURING, 0.0, 0.0, id="while the shutter was open"),
        pytest.param(FAR_DEG, BEFORE, 0.0, 0.0, id="a pose far off"),
        pytest.param(NEAR_DEG, BEFORE, math.nan, 0.0, id="nothing bounds the stamps"),
        pytest.param(NEAR_DEG, BEFORE, -LATENCY_S + 0.005, 0.0, id="stamped at the command"),
        pytest.param(NEAR_DEG, BEFORE, EXPOSURE_S + REPORT_S - 0.003, 0.0, id="stamped at the report"),
        pytest.param(NEAR_DEG, BEFORE, 0.0, 0.04, id="an irregular shutter"),
    ],
)
def test_otherwise_the_photo_is_taken_again(
    pitch_deg: float, span_s: tuple[float, float], stamps_s: float, irregular_s: float
) -> None:
    world = flown(lambda w: gusts(w, pitch_deg=pitch_deg, span_s=span_s, stamps_s=stamps_s, irregular_s=irregular_s))
    rejected = world.sink.of(ev.ShotRejected)
    assert [event.code for event in rejected] == ["pointing"]
    assert "pitch off by +0.1" in rejected[0].reason


@pytest.mark.parametrize("age_s", [0.05, 0.07, 0.1, 0.13, 0.15])
@pytest.mark.parametrize("pitch_deg", [NEAR_DEG, FAR_DEG])
def test_a_gust_is_seen_while_the_shutter_was_open_though_reports_of_it_are_late(
    age_s: float, pitch_deg: float
) -> None:
    """Between the age at which reports are known to be old and none: they show the exposure when it is over."""

    def prepare(world: World) -> None:
        gusts(world, pitch_deg=pitch_deg, span_s=DURING, stamps_s=0.0)
        world.gimbal.report_age_s = age_s

    world = flown(prepare)
    assert [event.code for event in world.sink.of(ev.ShotRejected)] == ["pointing"]
