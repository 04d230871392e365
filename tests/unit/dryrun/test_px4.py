"""Starting PX4 in software: which binary is PX4, what it is given, what is left of it; with a stand-in program."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import pytest

from panoexec.dryrun.autopilot import firmware_of, running_sitl
from panoexec.dryrun.firmware import SitlOptions
from panoexec.dryrun.rigs import SitlVehicle
from panoexec.errors import UsageError
from panoexec.sim.config import AirframeConfig, AxisConfig, GimbalConfig, SimConfig
from panoexec.sim.ports import free_udp_ports
from tests.waiting import wait_until

STAND_IN = """
    import json, os, pathlib, shutil, sys, time
    script = shutil.which("px4-rc.mavlink", os.F_OK)
    told = {"argv": sys.argv[1:], "env": dict(os.environ), "script": open(script).read()}
    instance = sys.argv[sys.argv.index("-i") + 1]
    pathlib.Path(f"/tmp/px4_lock-{instance}").touch()
    pathlib.Path("told.tmp").write_text(json.dumps(told))
    os.rename("told.tmp", TOLD)
    time.sleep(60)
"""


def built(folder: Path, told: Path) -> Path:
    """A folder laid out as a build of PX4, with a program that writes down what it is given."""
    startup = folder / "etc/init.d-posix/rcS"
    startup.parent.mkdir(parents=True)
    startup.touch()
    binary = folder / "bin/px4"
    binary.parent.mkdir()
    text = textwrap.dedent(STAND_IN).replace("TOLD", repr(str(told)))
    binary.write_text(f"#!{sys.executable} -S\n{text}", encoding="utf-8")
    binary.chmod(0o755)
    return binary


def options(binary: Path, **changes: object) -> SitlOptions:
    ground, payload = free_udp_ports(2)
    chosen = SitlOptions(
        binary=binary, ground_port=ground, payload_port=payload, speedup=1.0, home=(47.5, 8.25, 488.0, 20.0),
        parameters={"SIH_WIND_N": -8.0},
    )  # fmt: skip
    return replace(chosen, **changes)  # type: ignore[arg-type]


def there(path: Path) -> bool:
    return path.exists()


def read(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize(("port", "links"), [(None, 2), (40003, 3)])
def test_another_station_gets_a_link_of_its_own_where_there_is_one(
    tmp_path: Path, port: int | None, links: int
) -> None:
    binary = built(tmp_path / "px4", tmp_path / "told")
    (tmp_path / "run").mkdir()
    firmware_of(binary).launch(tmp_path / "run", options(binary, station_port=port))
    script = read(tmp_path / "run/scripts/px4-rc.mavlink")
    assert script.count("mavlink start") == links
    assert ("-o 40003" in script) is (port is not None)
    other = tmp_path / "arducopter"
    other.write_text("", encoding="utf-8")
    (tmp_path / "copter").mkdir()
    command = firmware_of(other).launch(tmp_path / "copter", options(other, station_port=port)).command
    expected = "none" if port is None else "udpclient:127.0.0.1:40003"
    assert command[command.index("--serial2") + 1] == expected


def test_a_binary_is_px4_if_its_start_up_files_are_beside_it(tmp_path: Path) -> None:
    binary = built(tmp_path / "px4", tmp_path / "told")
    assert firmware_of(binary).kind == "px4"
    link = tmp_path / "px4-by-another-name"
    link.symlink_to(binary)
    assert firmware_of(link).kind == "px4"
    other = tmp_path / "arducopter"
    other.write_text("", encoding="utf-8")
    assert firmware_of(other).kind == "ardupilot"


async def test_px4_is_given_ports_parameters_and_home_and_leaves_nothing(tmp_path: Path) -> None:
    told = tmp_path / "told"
    given = options(built(tmp_path / "px4", told), speedup=2.0)
    async with running_sitl(given):
        await asyncio.to_thread(wait_until, told.exists)
        lock = Path(f"/tmp/px4_lock-{given.ground_port}")
        assert there(lock)
    assert not there(lock)
    seen = json.loads(read(told))
    assert seen["argv"][-1] == str(tmp_path / "px4/etc")
    assert seen["env"]["PX4_SIM_MODEL"] == "sihsim_quadx"
    assert seen["env"]["PX4_SIM_SPEED_FACTOR"] == "2"
    assert float(seen["env"]["PX4_HOME_LAT"]) == 47.5
    assert float(seen["env"]["PX4_PARAM_SIH_WIND_N"]) == -8.0
    assert seen["env"]["PX4_PARAM_MNT_MODE_OUT"] == "2"
    assert f"-m onboard -o {given.ground_port}\n" in seen["script"]
    assert f"-m gimbal -o {given.payload_port}\n" in seen["script"]
    assert not there(Path(seen["argv"][seen["argv"].index("-w") + 1]))


def test_the_wind_blows_from_where_it_is_said_to(tmp_path: Path) -> None:
    firmware = firmware_of(built(tmp_path / "px4", tmp_path / "told"))
    wind = AirframeConfig(wind_m_s=8.0, wind_from_deg=90.0)
    parameters = firmware.parameters(SimConfig(airframe=wind))
    assert parameters["SIH_WIND_E"] == pytest.approx(-8.0)  # from the east: the air moves west
    assert parameters["SIH_WIND_N"] == pytest.approx(0.0, abs=1e-9)


def test_a_limited_pan_range_is_told(tmp_path: Path) -> None:
    firmware = firmware_of(built(tmp_path / "px4", tmp_path / "told"))
    pan = AxisConfig(rate_deg_s=90.0, acceleration_deg_s2=360.0, min_deg=-40.0, max_deg=40.0)
    simulation = SimConfig(gimbal=GimbalConfig(yaw=pan, yaw_endless=False))
    assert firmware.parameters(simulation)["MNT_RANGE_YAW"] == 80.0


def test_a_servo_camera_is_refused_before_anything_is_started(tmp_path: Path) -> None:
    binary = built(tmp_path / "px4", tmp_path / "told")
    with pytest.raises(UsageError, match="--trigger servo"):
        SitlVehicle(binary=binary, simulation=SimConfig(camera_kind="servo"))


KILLED = """
    import asyncio
    from pathlib import Path
    from panoexec.dryrun.autopilot import running_sitl
    from panoexec.dryrun.firmware import SitlOptions

    async def main():
        given = SitlOptions(
            binary=Path(BINARY), ground_port=PORT, payload_port=PORT + 1, speedup=1.0, home=(47.5, 8.25, 488.0, 20.0),
            parameters={},
        )
        async with running_sitl(given):
            await asyncio.sleep(60)

    asyncio.run(main())
"""


def test_nothing_of_it_is_left_when_its_parent_is_killed(tmp_path: Path) -> None:
    told = tmp_path / "told"
    (port,) = free_udp_ports(1)
    binary = str(built(tmp_path / "px4", told))
    script = textwrap.dedent(KILLED).replace("BINARY", repr(binary)).replace("PORT", str(port))
    with subprocess.Popen([sys.executable, "-c", script], env=os.environ | {"TMPDIR": str(tmp_path)}) as process:
        try:
            wait_until(told.exists)
            left = [Path(f"/tmp/px4_lock-{port}"), *tmp_path.glob("panoexec-sitl-*")]
            assert [there(path) for path in left] == [True, True]
        finally:
            process.kill()
    wait_until(lambda: not any(there(path) for path in left))
