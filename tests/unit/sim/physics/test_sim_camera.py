"""The camera model: shutter timing, rejected commands, counts."""

from __future__ import annotations

import dataclasses

import pytest

from panoexec.sim.config import CameraConfig
from panoexec.sim.physics.camera import CameraModel, Exposure, GimbalState, Refusal
from panoexec.sim.physics.gimbal import Angles
from panoexec.sim.physics.world import Timeline

CONFIG = CameraConfig(exposure_s=0.02, latency_s=0.05, interval_s=1.0, storage_mib=30.0, image_mib=10.0, index_start=7)


class Bench:
    """A camera that looks at a clock: yaw = the time of the look."""

    def __init__(self, config: CameraConfig = CONFIG) -> None:
        self.timeline = Timeline()
        self.exposures: list[Exposure] = []
        self.camera = CameraModel(config, self.timeline, look=self._look, on_exposed=self.exposures.append)

    def _look(self) -> GimbalState:
        now = Angles(self.timeline.now_s, 0.0, 0.0)
        return GimbalState(truth=now, estimate=now, measured=now)


def test_shutter_opens_after_the_latency_and_samples_attitudes_during_the_exposure() -> None:
    bench = Bench()
    bench.timeline.run_until(2.0)
    assert bench.camera.shoot() is None
    assert bench.camera.is_busy
    bench.timeline.run_until(2.069)
    assert bench.exposures == []
    bench.timeline.run_until(2.07)
    (exposure,) = bench.exposures
    assert [exposure.start_s, exposure.end_s] == pytest.approx([2.05, 2.07])
    assert [angles.yaw_deg for angles in exposure.truth] == pytest.approx([2.05, 2.055, 2.06, 2.065, 2.07])
    assert exposure.measured.yaw_deg == pytest.approx(2.05)
    assert exposure.index == 7
    assert not bench.camera.is_busy


def test_it_rejects_commands_within_its_interval_and_reports_the_wait() -> None:
    bench = Bench()
    assert bench.camera.shoot() is None
    assert bench.camera.shoot() is Refusal.BUSY
    bench.timeline.run_until(0.9)
    assert bench.camera.wait_s == pytest.approx(0.1)
    assert bench.camera.shoot() is Refusal.BUSY
    bench.timeline.run_until(1.0)
    assert bench.camera.shoot() is None
    bench.timeline.run_until(3.0)
    assert [exposure.index for exposure in bench.exposures] == [7, 8]


def test_slightly_early_command_is_accepted_with_a_coarse_clock() -> None:
    timeline = Timeline()
    now = Angles(0.0, 0.0, 0.0)
    camera = CameraModel(
        CONFIG, timeline, look=lambda: GimbalState(truth=now, estimate=now, measured=now), on_exposed=lambda _: None,
        time_resolution_s=0.05,
    )  # fmt: skip
    assert camera.shoot() is None
    timeline.run_until(0.9)
    assert camera.shoot() is Refusal.BUSY
    timeline.run_until(0.96)
    assert camera.shoot() is None


def test_full_card_rejects_photos() -> None:
    bench = Bench()
    for number in range(3):
        assert bench.camera.available_mib == 30.0 - 10.0 * number
        assert bench.camera.shoot() is None
        bench.timeline.run_until(bench.timeline.now_s + 2.0)
    assert bench.camera.shoot() is Refusal.STORAGE_FULL
    assert bench.camera.images == 3


def test_a_fault_fills_the_card_and_frees_it_again() -> None:
    bench = Bench(dataclasses.replace(CONFIG, storage_mib=1000.0))
    bench.camera.storage_full = True
    assert bench.camera.available_mib == 0.0
    assert bench.camera.shoot() is Refusal.STORAGE_FULL
    bench.camera.storage_full = False
    assert bench.camera.shoot() is None


def test_a_short_exposure_is_seen_at_its_ends() -> None:
    bench = Bench(dataclasses.replace(CONFIG, exposure_s=0.001))
    bench.camera.shoot()
    bench.timeline.run_until(1.0)
    assert [angles.yaw_deg for angles in bench.exposures[0].truth] == pytest.approx([0.05, 0.051])
