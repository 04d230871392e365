"""The doctor on simulated vehicles: healthy, limited, none."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import sys
from pathlib import Path
from typing import Any

import pytest

from panoexec.clock import SystemClock
from panoexec.doctor.findings import Findings
from panoexec.doctor.run_checks import run_checks
from panoexec.doctor.vehicle import check_vehicle
from panoexec.dryrun.arducopter import BINARY_VARIABLE
from panoexec.dryrun.autopilot import sitl_binary
from panoexec.dryrun.rigs import SitlVehicle
from panoexec.inputs.config import Config, load_config
from panoexec.sim.config import CameraConfig, SimConfig
from panoexec.sim.faults import parse_fault
from panoexec.sim.ports import free_udp_port
from panoexec.sim.process import running_simulator
from tests.wire.broker import needs_mosquitto, running_broker

SPEEDUP = 6.0
PATIENCE_S = 45.0


def config_text(port: int, folder: Path, more: str = "") -> str:
    storage = f'[storage]\npath = "{folder}/data"\nmin_free_mb = 1\n'
    return f'[vehicle]\nconnection = "udpin://127.0.0.1:{port}"\n{storage}{more}'


def found(document: dict[str, Any], area: str, check: str) -> dict[str, Any]:
    (one,) = [f for f in document["findings"] if (f["area"], f["check"]) == (area, check)]
    return dict(one)


async def doctor(folder: Path, text: str, *arguments: str) -> tuple[int, dict[str, Any], str]:
    """Run `panoexec doctor`: exit code, JSON document, standard error."""
    (folder / "config.toml").write_text(text)
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "panoexec", "doctor", "--config", str(folder / "config.toml"), "--json", *arguments),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        out, err = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode is not None
    return process.returncode, json.loads(out) if out else {}, err.decode()


async def examined(folder: Path, port: int, more: str = "", *, patience_s: float = PATIENCE_S) -> Findings:
    (folder / "config.toml").write_text(config_text(port, folder, more))
    config: Config = load_config(folder / "config.toml", {})
    return await run_checks(config, folder / "config.toml", clock=SystemClock(SPEEDUP), patience_s=patience_s)


async def test_a_serial_port_that_is_absent_is_told_by_its_own_key() -> None:
    findings = Findings()
    config = Config.model_validate({"vehicle": {"serial": "/dev/no-such-port"}})
    await check_vehicle(config, findings, clock=SystemClock(), patience_s=1)
    (one,) = findings.all
    assert one.found == "cannot open /dev/no-such-port: no such device; is it plugged in?"
    assert one.advice == '[vehicle] serial: another device, or "auto", which finds it by USB id'


@needs_mosquitto
async def test_healthy_vehicle(tmp_path: Path) -> None:
    port = free_udp_port()
    with running_broker(tmp_path) as broker:
        more = f'[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\n'
        async with running_simulator(SimConfig(port=port, speedup=SPEEDUP)):
            arguments = ("--speedup", str(SPEEDUP), "--timeout", str(PATIENCE_S), "--photo")
            code, document, said = await doctor(tmp_path, config_text(port, tmp_path, more), *arguments)
    missing = [f for f in document["findings"] if f["verdict"] == "missing"]
    assert [f for f in missing if f["area"] != "rates"] == [], said
    # a very busy computer does not get all messages, and is told so
    assert (code, document["healthy"]) == ((3, False) if missing else (0, True))
    assert (document["autopilot"], document["vehicle"]) == ("ardupilot", "drone")
    assert "ArduPilot 4.7.0" in found(document, "link", "autopilot")["found"]
    components = found(document, "link", "components")["found"]
    assert "154 (gimbal)" in components
    assert "100 (camera)" in components
    attitude = found(document, "rates", "GIMBAL_DEVICE_ATTITUDE_STATUS")
    assert attitude["needed"] == "50 Hz"
    assert "from component 154" in attitude["found"] or attitude["verdict"] != "ok", "a slow computer has fewer"
    for name in ("ATTITUDE", "GIMBAL_MANAGER_STATUS", "GLOBAL_POSITION_INT", "SYS_STATUS", "EXTENDED_SYS_STATE"):
        assert found(document, "rates", name)["needed"].endswith(" Hz")
    assert "MNT1_TYPE = 6" in found(document, "gimbal", "found")["found"]
    assert "pitch -90 to 90°, yaw endless" in found(document, "gimbal", "limits")["found"]
    assert found(document, "gimbal", "feedback")["found"].startswith("vehicle: measured")
    assert found(document, "gimbal", "control")["verdict"] == "ok"
    assert found(document, "camera", "profile")["verdict"] == "ok"
    assert "up to capture_message" in found(document, "camera", "evidence")["found"]
    assert "capture_message after" in found(document, "camera", "photo")["found"]
    assert found(document, "mission", "plan")["found"].startswith("18 images")
    assert "MQTT 5" in found(document, "broker", "connection")["found"]
    assert found(document, "broker", "answers")["verdict"] == "ok"
    assert " UTC, this computer is " in found(document, "clock", "vehicle")["found"]


async def poor_vehicle(folder: Path) -> Findings:
    """A servo mount and a servo camera, and a configuration that asks for more."""
    port = free_udp_port()
    sim = SimConfig(port=port, speedup=SPEEDUP, mount="servo", camera_kind="servo")
    more = '[camera]\nevidence = "feedback_pin"\n[mission]\nmethod = "paper"\n'
    more += '[guards]\nallowed_modes = ["HOLD"]\nbattery_floor_frac = 0.99\n'
    async with running_simulator(sim):
        return await examined(folder, port, more)


async def busy_px4(folder: Path) -> Findings:
    """A PX4 whose gimbal somebody else has, and a nearly full card."""
    port = free_udp_port()
    sim = SimConfig(
        port=port,
        speedup=SPEEDUP,
        autopilot="px4",
        faults=(parse_fault("control-stolen=t0"),),
        camera=CameraConfig(storage_mib=100),
    )
    more = '[camera]\nprofile = "sony-a7r-iv-35mm"\n[mission]\nmethod = "paper"\n'
    async with running_simulator(sim):
        return await examined(folder, port, more)


async def test_limited_and_busy_devices_are_reported_with_advice(tmp_path: Path) -> None:
    """Side by side: finding a gimbal that does not tell its name takes MAVSDK 6 s."""
    for name in ("poor", "px4"):
        (tmp_path / name).mkdir()
    async with asyncio.TaskGroup() as group:
        poor = group.create_task(poor_vehicle(tmp_path / "poor"), name="servos on ArduPilot")
        busy = group.create_task(busy_px4(tmp_path / "px4"), name="somebody else's gimbal on PX4")
    document = poor.result().document()
    assert poor.result().exit_code == 3
    feedback = found(document, "gimbal", "feedback")
    assert (feedback["verdict"], feedback["found"][:5]) == ("missing", "none:")
    assert "MNT1_TYPE = 6" in feedback["advice"]
    evidence = found(document, "camera", "evidence")
    assert (evidence["verdict"], evidence["found"]) == ("missing", "up to counted")
    assert "CAM1_FEEDBAK_PIN" in evidence["advice"]
    assert found(document, "vehicle", "flight mode")["verdict"] == "warning"
    assert found(document, "vehicle", "battery")["verdict"] == "missing"
    assert found(document, "broker", "address")["verdict"] == "note"
    document = busy.result().document()
    assert document["autopilot"] == "px4"
    assert "MNT_MODE_OUT = 2" in found(document, "gimbal", "found")["found"]
    control = found(document, "gimbal", "control")
    assert control["verdict"] == "warning"
    assert "system 255 component 190 has it; not taken from it" in control["found"]
    assert found(document, "camera", "storage")["found"] == "space for 8 photos"
    assert found(document, "camera", "profile")["verdict"] == "warning"


async def test_without_an_autopilot_both_kinds_of_parameters_are_named(tmp_path: Path) -> None:
    findings = await examined(tmp_path, free_udp_port(), patience_s=0.3)
    document = findings.document()
    assert (findings.exit_code, document["healthy"], document["autopilot"]) == (3, False, None)
    link = found(document, "link", "autopilot")
    assert link["verdict"] == "missing"
    assert "SERIALn_PROTOCOL" in link["advice"]
    assert "MAV_n_CONFIG" in link["advice"]
    assert found(document, "gimbal", "not examined")["verdict"] == "note"
    assert found(document, "disk", "storage")["verdict"] == "ok", "the rest is examined all the same"


async def test_port_in_use_by_the_daemon(tmp_path: Path) -> None:
    config = Config.model_validate({"vehicle": {"connection": "udpin://127.0.0.1:1"}, "storage": {"path": tmp_path}})
    findings = Findings()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        url = f"udpin://127.0.0.1:{other.getsockname()[1]}"
        taken = config.model_copy(update={"vehicle": config.vehicle.model_copy(update={"connection": url})})
        await check_vehicle(taken, findings, clock=SystemClock(), patience_s=1.0)
    port = found(findings.document(), "link", "port")
    assert port["verdict"] == "missing"
    assert "systemctl stop panoexec" in port["advice"]


@pytest.mark.skipif(not os.environ.get(BINARY_VARIABLE), reason=f"set {BINARY_VARIABLE} to an ArduCopter SITL binary")
async def test_ardupilot_sitl(tmp_path: Path) -> None:
    vehicle = SitlVehicle(binary=sitl_binary(None), simulation=SimConfig())
    async with vehicle.running(images=None, note=lambda _: None) as rig:
        text = config_text(1, tmp_path).replace("udpin://127.0.0.1:1", rig.connection)
        code, document, said = await doctor(tmp_path, text, "--timeout", "60")
    (tmp_path / "doctor.json").write_text(json.dumps(document, indent=1))
    assert document["autopilot"] == "ardupilot", said
    assert found(document, "gimbal", "found")["verdict"] == "ok"
    assert found(document, "gimbal", "control")["verdict"] == "ok"
    assert "MNT1_TYPE = 6" in found(document, "gimbal", "found")["found"]
    assert found(document, "rates", "GIMBAL_DEVICE_ATTITUDE_STATUS")["verdict"] == "ok"
    assert found(document, "camera", "evidence")["verdict"] == "ok"
    assert code == 0, json.dumps(document, indent=1)
