"""Findings of the doctor, and its checks of the computer."""

from __future__ import annotations

import os
import time
from datetime import UTC, datetime
from pathlib import Path

import pytest

from panoexec.doctor import machine
from panoexec.doctor.advice import advise
from panoexec.doctor.findings import AREAS, DEVICE_AREAS, Findings, Verdict
from panoexec.inputs.config import Config


@pytest.mark.parametrize(
    ("missing", "code"), [([], 0), (["disk"], 1), (["clock", "mission"], 1), (["disk", "broker"], 3), (["gimbal"], 3)]
)
def test_exit_code_depends_on_the_area_of_missing_items(missing: list[str], code: int) -> None:
    findings = Findings()
    findings.ok("link", "port", "there")
    findings.warning("camera", "storage", "little")
    for area in missing:
        findings.missing(area, "it", "gone")
    assert findings.exit_code == code
    assert findings.document()["healthy"] is (code == 0)
    assert findings.count(Verdict.MISSING) == len(missing)


def test_findings_are_shown_area_by_area() -> None:
    findings = Findings()
    for area in reversed(AREAS):
        findings.note(area, "first", "x")
    findings.ok("link", "second", "x")
    assert [finding.area for finding in findings.all] == ["link", *AREAS]
    assert [finding.check for finding in findings.all[:2]] == ["first", "second"]
    assert set(AREAS) >= DEVICE_AREAS


def test_judge_adds_advice_only_to_missing_items() -> None:
    findings = Findings()
    findings.judge("disk", "room", 1 > 0, "much", advice="delete")
    findings.judge("disk", "room", 1 < 0, "little", advice="delete")
    assert [(finding.verdict, finding.advice) for finding in findings.all] == [("ok", ""), ("missing", "delete")]


def test_advice_names_the_autopilots_own_parameters_or_both_kinds() -> None:
    assert "MNT1_TYPE" in advise("gimbal", "ardupilot")
    assert "MNT_MODE_OUT" not in advise("gimbal", "ardupilot")
    assert "MNT_MODE_OUT" in advise("gimbal", "px4")
    both = advise("gimbal", "")
    assert "ArduPilot: MNT1_TYPE" in both
    assert "PX4: MNT_MODE_IN" in both


def test_advice_for_px4_names_no_removed_parameter() -> None:
    # outputs get their function by number since 1.13: 2000 Camera_Trigger, 2032 Camera_Capture (output_functions.yaml)
    assert "TRIG_PINS" not in advise("camera", "px4")
    assert "PWM_AUX_FUNCn = 2000" in advise("camera", "px4")
    assert "PWM_AUX_FUNCn = 2032" in advise("evidence", "px4")
    # 1.18 has a limit for each direction instead of a symmetric range
    assert {"MNT_MIN_PITCH,", "MNT_MAX_PITCH"} <= set(advise("limits", "px4").split())


# --- this computer


def a_config(storage: Path, **sections: dict[str, object]) -> Config:
    return Config.model_validate({"storage": {"path": storage, "min_free_mb": 1}} | sections)


def verdict(findings: Findings, area: str, check: str) -> tuple[str, str]:
    (found,) = [f for f in findings.all if (f.area, f.check) == (area, check)]
    return found.verdict.value, f"{found.found} {found.advice}"


def test_usable_storage(tmp_path: Path) -> None:
    findings = Findings()
    machine.check_machine(a_config(tmp_path / "new"), tmp_path / "c.toml", findings)
    assert verdict(findings, "disk", "storage")[0] == "ok"
    assert verdict(findings, "disk", "room")[0] == "ok"
    assert verdict(findings, "clock", "date")[0] == "ok"
    assert list((tmp_path / "new").iterdir()) == [], "nothing is left behind"


def test_unwritable_and_full_storage_are_missing(tmp_path: Path) -> None:
    findings = Findings()
    machine.check_disk(a_config(Path("/proc/nowhere")), findings)
    kind, text = verdict(findings, "disk", "storage")
    assert kind == "missing"
    assert "/proc/nowhere" in text
    assert "[storage] path" in text
    findings = Findings()
    machine.check_disk(Config.model_validate({"storage": {"path": tmp_path, "min_free_mb": 1e12}}), findings)
    assert verdict(findings, "disk", "room")[0] == "missing"


def test_slow_disk_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_sync_time", lambda _: 0.5)
    findings = Findings()
    machine.check_disk(a_config(tmp_path), findings)
    assert verdict(findings, "disk", "speed")[0] == "warning"


@pytest.mark.parametrize(
    ("now", "mission", "kind"),
    [
        (datetime(1970, 1, 1, 0, 1, tzinfo=UTC), "", "warning"),
        (datetime(2026, 12, 1, tzinfo=UTC), "20261130T000000.000Z", "ok"),
        (datetime(2026, 12, 1, tzinfo=UTC), "20261202T000000.000Z", "warning"),
    ],
)
def test_an_implausible_clock_is_told_and_keeps_nobody_from_flying(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, now: datetime, mission: str, kind: str
) -> None:
    if mission:
        (tmp_path / "missions" / mission).mkdir(parents=True)
    monkeypatch.setattr(time, "time", now.timestamp)
    findings = Findings()
    machine.check_clock(tmp_path, findings)
    assert verdict(findings, "clock", "date")[0] == kind


@pytest.mark.parametrize(("answer", "kind"), [(True, "ok"), (False, "warning"), (None, "note")])
def test_clock_without_time_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: bool | None, kind: str
) -> None:
    monkeypatch.setattr(machine, "clock_synchronised", lambda: answer)
    findings = Findings()
    machine.check_clock(tmp_path, findings)
    assert verdict(findings, "clock", "synchronised")[0] == kind


def test_kernel_reports_clock_synchronisation() -> None:
    assert machine.clock_synchronised() in (True, False, None)


@pytest.mark.parametrize(
    ("vehicle", "user"),
    [
        ({"connection": "udpin://0.0.0.0:14540"}, "runuser -u panoexec -- panoexec doctor"),
        ({"serial": "auto"}, "runuser -u panoexec -g panoexec -G dialout -- panoexec doctor"),
    ],
)
def test_root_gets_the_command_for_the_service_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, vehicle: dict[str, object], user: str
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(Path, "owner", lambda _: "panoexec")
    findings = Findings()
    machine.check_permissions(a_config(tmp_path, vehicle=vehicle), tmp_path / "c.toml", findings)
    (finding,) = findings.all
    assert finding.verdict == "warning"
    assert finding.advice == f"{user} --config {tmp_path / 'c.toml'}"


def test_serial_devices_must_exist_and_be_accessible(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = tmp_path / "ttyACM0"
    device.write_text("")
    config = a_config(
        tmp_path,
        vehicle={"connection": f"serial://{device}:57600"},
        camera={"trigger": "serial", "serial_port": str(tmp_path / "gone")},
    )
    findings = Findings()
    machine.check_permissions(config, tmp_path / "c.toml", findings)
    assert verdict(findings, "permissions", "vehicle.connection")[0] == "ok"
    assert verdict(findings, "permissions", "camera.serial_port")[0] == "missing"
    monkeypatch.setattr(os, "access", lambda *_: False)
    findings = Findings()
    machine.check_permissions(config, tmp_path / "c.toml", findings)
    kind, text = verdict(findings, "permissions", "vehicle.connection")
    assert kind == "missing"
    assert "usermod -aG" in text
