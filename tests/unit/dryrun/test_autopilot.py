"""Choosing, starting, monitoring and stopping an autopilot binary, with stand-in programs."""

import asyncio
import itertools
import os
import signal
import stat
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from panoexec.dryrun.arducopter import BINARY_VARIABLE, PARAMETER_FILE
from panoexec.dryrun.autopilot import running_sitl, sitl_binary
from panoexec.dryrun.firmware import SitlOptions
from panoexec.errors import DeviceError, UsageError
from panoexec.sim.ports import free_udp_ports
from tests.repository import ROOT
from tests.waiting import wait_until

WAITS = """
    import pathlib, sys, time
    pathlib.Path({told!r}).write_text("\\n".join(sys.argv[1:]) + "\\n" + str(pathlib.Path.cwd()))
    time.sleep(60)
"""


def program(path: Path, text: str) -> Path:
    path.write_text(f"#!{sys.executable} -S\n{textwrap.dedent(text)}", encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def options(binary: Path) -> SitlOptions:
    return SitlOptions(
        binary=binary,
        ground_port=40001,
        payload_port=40002,
        speedup=2.5,
        home=(47.5, 8.25, 488.0, 20.0),
        parameters={"SIM_WIND_SPD": 8, "SIM_WIND_DIR": 250.5},
    )


async def written(path: Path) -> str:
    """What a program wrote, as soon as it is there."""

    def read() -> str:
        wait_until(lambda: path.exists() and path.stat().st_size)
        return path.read_text(encoding="utf-8")

    return await asyncio.to_thread(read)


def is_gone(folder: str) -> bool:
    return not Path(folder).exists()


def is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def test_a_binary_is_taken_from_the_option_or_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named, other = program(tmp_path / "named", ""), program(tmp_path / "other", "")
    monkeypatch.setenv(BINARY_VARIABLE, str(other))
    assert sitl_binary(str(named)) == named
    assert sitl_binary(None) == sitl_binary("") == other
    monkeypatch.delenv(BINARY_VARIABLE)
    monkeypatch.setenv("PX4_SITL", str(named))
    assert sitl_binary(None) == named
    monkeypatch.delenv("PX4_SITL")
    with pytest.raises(UsageError, match=BINARY_VARIABLE):
        sitl_binary(None)


@pytest.mark.parametrize(
    ("name", "problem"),
    [("missing", "no such file"), ("folder", "not a file"), ("plain", "not executable"), ("vehicle.py", "a script")],
)
def test_invalid_binaries_are_rejected_by_name(tmp_path: Path, name: str, problem: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "plain").touch()
    program(tmp_path / "vehicle.py", "")
    with pytest.raises(UsageError, match=f"{name}: .*{problem}.*expected") as caught:
        sitl_binary(str(tmp_path / name))
    assert caught.value.exit_code == 2


async def test_it_gets_our_parameters_and_its_own_folder(tmp_path: Path) -> None:
    told = tmp_path / "told"
    binary = program(tmp_path / "sitl", WAITS.format(told=str(told)))
    async with running_sitl(options(binary)) as sitl:
        *arguments, folder = (await written(told)).splitlines()
        pairs = dict(itertools.pairwise(arguments))
        assert pairs["--serial0"] == "udpclient:127.0.0.1:40001"
        assert pairs["--serial1"] == "udpclient:127.0.0.1:40002"
        assert pairs["--speedup"] == "2.5"
        assert pairs["--home"] == "47.5000000,8.2500000,488.00,20.0"
        shipped, added = (Path(folder) / name for name in pairs["--defaults"].split(","))
        assert added.read_text(encoding="utf-8").splitlines() == ["SIM_WIND_SPD 8", "SIM_WIND_DIR 250.5"]
        assert shipped.read_bytes() == (ROOT / "config" / PARAMETER_FILE).read_bytes()
        assert is_alive(sitl.pid)
    assert not is_alive(sitl.pid)
    assert is_gone(folder)


def test_parameter_file_contains_what_a_first_boot_needs() -> None:
    lines = (ROOT / "config" / PARAMETER_FILE).read_text(encoding="utf-8").splitlines()
    values = [line.partition("#")[0].split() for line in lines]
    known = {name: float(value) for name, value in filter(None, values)}
    # without CAM2_TYPE beside it the firmware resets CAM1_TYPE at its first boot
    assert (known["MNT1_TYPE"], known["CAM1_TYPE"], known["CAM2_TYPE"]) == (6, 6, 0)
    # the airframe is started as `--model +`: with the default of FRAME_TYPE (X) it shakes by 1.2° at 15 Hz in wind
    assert (known["FRAME_CLASS"], known["FRAME_TYPE"], known["MNT1_PITCH_MIN"]) == (1, 0, -90)


async def test_it_is_killed_if_it_ignores_sigterm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panoexec.dryrun.autopilot._TERM_S", 0.2)
    told = tmp_path / "told"
    stubborn = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN)\n" + textwrap.dedent(
        WAITS.format(told=str(told))
    )
    async with running_sitl(options(program(tmp_path / "sitl", stubborn))) as sitl:
        await written(told)
    assert not is_alive(sitl.pid)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("print('panic: no frame'); raise SystemExit(3)", r"exit code 3\).*panic: no frame"),
        ("import os; os.kill(os.getpid(), 11)", r"signal 11\).*without output"),
        ("", r"exit code 0"),
    ],
)
async def test_unexpected_exit_reports_the_last_output_line(tmp_path: Path, text: str, words: str) -> None:
    async with running_sitl(options(program(tmp_path / "sitl", text))) as sitl:
        with pytest.raises(DeviceError, match=words):
            await asyncio.wait_for(sitl.watch(), 60)


async def test_a_file_that_cannot_run_here_is_a_usage_error(tmp_path: Path) -> None:
    foreign = tmp_path / "sitl"
    foreign.write_bytes(b"\x7fELF no program of this machine")
    foreign.chmod(0o755)
    async with running_sitl(options(foreign)) as sitl:
        with pytest.raises(UsageError, match="cannot be executed"):
            await asyncio.wait_for(sitl.watch(), 60)


def test_it_does_not_outlive_a_parent_that_is_killed(tmp_path: Path) -> None:
    told = tmp_path / "told"
    stubborn = program(
        tmp_path / "sitl",
        "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        + textwrap.dedent(WAITS.format(told=str(told))),
    )
    parent = textwrap.dedent(f"""
        import asyncio
        from pathlib import Path
        from panoexec.dryrun.autopilot import running_sitl
        from panoexec.dryrun.firmware import SitlOptions
        async def main():
            async with running_sitl(SitlOptions(binary=Path({str(stubborn)!r}), ground_port=1, payload_port=2,
                                                speedup=1, home=(0, 0, 0, 0), parameters={{}})) as sitl:
                while not Path({str(told)!r}).exists():
                    await asyncio.sleep(0.01)
                print(sitl.pid, flush=True)
                await asyncio.sleep(60)
        asyncio.run(main())
    """)
    environment = os.environ | {"TMPDIR": str(tmp_path)}  # nobody is left to remove its folder
    with subprocess.Popen(
        [sys.executable, "-c", parent], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        pid = int(process.stdout.readline())
        assert is_alive(pid)
        process.send_signal(signal.SIGKILL)
    wait_until(lambda: not is_alive(pid))


def test_ports_are_free_and_different() -> None:
    ports = free_udp_ports(5)
    assert len(set(ports)) == 5
    assert all(1024 <= port <= 65535 for port in ports)
