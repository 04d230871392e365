"""The manifest of real (fake-flown) missions."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panoexec.angles import rotation, rotation_from_quaternion
from panoexec.errors import InputFileError
from panoexec.mission.log import events as ev
from panoexec.store.manifest import ManifestWriter, read_manifest
from tests.unit.fakes.virtual import run_virtual
from tests.unit.fakes.world import World, a_world, some_settings


def _flown(path: Path, prepare: Any = None, **settings: Any) -> tuple[World, dict[str, Any]]:
    async def main() -> tuple[World, dict[str, Any]]:
        async with a_world(settings=some_settings(**settings)) as world:
            if prepare is not None:
                prepare(world)
            mission = world.mission()
            writer = ManifestWriter(
                path=path,
                plan=world.plan,
                record=mission.record,
                vehicle={"id": "v1"},
                clock=world.clock,
                certificate=lambda: mission.certificate,
            )
            publish = world.sink.publish

            def both(event: Any) -> None:
                publish(event)
                writer.publish(event)

            setattr(world.sink, "publish", both)  # noqa: B010
            async with asyncio.TaskGroup() as group:
                writing = group.create_task(writer.run(), name="manifest")
                await mission.run()
                writing.cancel()
            await writer.write()
            # what was put into words while it flew is what one who sees it for the first time would say
            fresh = ManifestWriter(
                path=path, plan=world.plan, record=mission.record, vehicle={"id": "v1"}, clock=world.clock,
                certificate=lambda: mission.certificate,
            )  # fmt: skip
            assert fresh.text() == writer.text()
            return world, read_manifest(path)

    return run_virtual(main())


def test_every_attempt_is_there_with_target_measurement_and_verdict(tmp_path: Path) -> None:
    def prepare(world: World) -> None:
        world.camera.lost_proofs = 1

    world, manifest = _flown(tmp_path / "manifest.json", prepare)
    assert manifest["format"] == "panoexec.manifest/1"
    assert (manifest["state"], manifest["mission_id"]) == ("complete", "m1")
    assert manifest["counts"] == {"shots_total": 4, "shots_done": 4, "attempts": 5, "retakes": 1, "missing": []}
    assert manifest["vehicle"] == {"id": "v1"}
    assert manifest["camera"]["hfov_deg"] == pytest.approx(60.0)
    assert manifest["certificate"]["certified"] is True
    first = manifest["shots"][0]
    assert [attempt["verdict"] for attempt in first["attempts"]] == ["rejected", "accepted"]
    assert first["accepted_attempt"] == 2
    assert "acknowledged" in first["attempts"][0]["reason"]
    for shot, planned in zip(manifest["shots"], world.plan.shots, strict=True):
        accepted = shot["attempts"][-1]
        assert accepted["evidence"] == "capture_message"
        assert shot["file"] == accepted["file"] == f"IMG_000{(2, 1, 3, 4)[planned.index]}.jpg"
        assert accepted["capture_time"].startswith("2023-11-14T22:")
        target, measured = accepted["target"], accepted["measured"]
        assert [target["pitch_deg"], target["roll_deg"]] == pytest.approx([planned.pitch_deg, 0.0])
        for pose in (target, measured):
            same = rotation(pose["yaw_deg"], pose["pitch_deg"], pose["roll_deg"])
            np.testing.assert_allclose(rotation_from_quaternion(pose["quaternion"]), same, atol=1e-9)
        apart = [measured[axis] - target[axis] for axis in ("pitch_deg", "roll_deg", "yaw_deg")]
        errors = accepted["error_deg"]
        for mean, worst in zip(apart, (errors["pitch"], errors["roll"], errors["yaw"]), strict=True):
            assert abs((mean + 180) % 360 - 180) <= abs(worst) + 1e-9


def test_a_missing_shot_and_its_reasons_stay_visible(tmp_path: Path) -> None:
    def prepare(world: World) -> None:
        world.gimbal.stuck = True

    _, manifest = _flown(tmp_path / "manifest.json", prepare, attempts=1, rounds=1)
    assert manifest["state"] == "incomplete"
    assert manifest["counts"]["missing"] == [0, 1, 2, 3]
    attempt = manifest["shots"][0]["attempts"][0]
    assert (attempt["measured"], attempt["error_deg"], attempt["evidence"]) == (None, None, "none")
    assert "not settled" in attempt["reason"]


def test_it_is_valid_json_without_nan(tmp_path: Path) -> None:
    def prepare(world: World) -> None:
        world.vehicle.change(latitude_deg=float("nan"))

    path = tmp_path / "manifest.json"
    _flown(path, prepare)

    def refuse(text: str) -> None:
        raise AssertionError(text)

    json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


@pytest.mark.parametrize(
    ("text", "problem"),
    [("{", "not JSON"), ('{"format": "panoexec.plan/1"}', "expected"), ("[]", "None found"), (None, "cannot be read")],
)
def test_other_files_are_refused(tmp_path: Path, text: str | None, problem: str) -> None:
    path = tmp_path / "manifest.json"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(InputFileError, match=problem):
        read_manifest(path)


def test_the_history_of_the_battery_goes_on_after_a_restart_and_holds_changes_only(tmp_path: Path) -> None:
    path = tmp_path / "manifest.json"
    charges = iter([0.8, 0.8, 0.7995, 0.79, float("nan")])

    async def main() -> list[dict[str, Any]]:
        async with a_world() as world:
            mission = world.mission()
            writer = ManifestWriter(
                path=path, plan=world.plan, record=mission.record, vehicle={}, clock=world.clock,
                certificate=lambda: None, battery=lambda: next(charges),
            )  # fmt: skip
            for _ in range(5):
                writer.publish(ev.Warned(code="x", text="y"))
            return list(json.loads(writer.text())["battery"])

    earlier = {"time": "2026-09-21T14:13:00.000Z", "charge_frac": 0.9}
    path.write_text(json.dumps({"format": "panoexec.manifest/1", "battery": [earlier]}), encoding="utf-8")
    found = run_virtual(main())
    assert found[0] == earlier
    assert [item["charge_frac"] for item in found] == [0.9, 0.8, 0.79]
    # a history that cannot be read is no reason not to fly
    charges = iter([0.8] * 5)
    path.write_text(json.dumps({"format": "panoexec.manifest/1", "battery": ["full"]}), encoding="utf-8")
    assert [item["charge_frac"] for item in run_virtual(main())] == [0.8]
