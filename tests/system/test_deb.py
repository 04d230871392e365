"""The package on a machine that systemd runs: installed, started, frozen, killed, misconfigured, upgraded, purged.

This installs and purges panoexec on the machine it runs on, so it only runs where that is wanted: as root on a Debian
booted by systemd, with PANOEXEC_SYSTEMD=1. PANOEXEC_DEB names a package to take instead of building one. The tests are
the chapters of one story and need each other, in this order.
"""

from __future__ import annotations

import asyncio
import grp
import json
import os
import pwd
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from panoexec.sim.ports import free_udp_port
from tests.repository import ROOT
from tests.system.daemon import SMALL, ground_station
from tests.system.systemd import CONFIG, STATE, UNIT, nothing_left, running, sh, show, wait, why_not
from tests.system.test_stops import TELE
from tests.wire.broker import Broker, needs_mosquitto, running_broker

SLOW = {"camera": TELE, "elevation_deg": [-90, 90], "overlap": 0.2}
DROP_IN = Path(f"/run/systemd/system/{UNIT}.d/test.conf")
WATCHDOG_S = 6
EDITED = "# edited by the administrator of this machine\n"


pytestmark = [needs_mosquitto, pytest.mark.skipif(bool(why_not()), reason=why_not() or "runs")]


@dataclass(frozen=True)
class Machine:
    """What the daemon talks to, and the package."""

    broker: Broker
    port: int
    package: Path

    def configure(self, more: str = "", *, resume: str = "auto") -> None:
        CONFIG.write_text(
            f'{EDITED}[vehicle]\nconnection = "udpin://127.0.0.1:{self.port}"\n'
            f'[mqtt]\nhost = "127.0.0.1"\nport = {self.broker.port}\n[storage]\nmin_free_mb = 1\n'
            f'[guards]\nallowed_modes = []\nbattery_floor_frac = 0\n[mission]\nresume = "{resume}"\n{more}'
        )


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    folder = tmp_path_factory.mktemp("machine")
    package = Path(os.environ.get("PANOEXEC_DEB") or _built())
    port = free_udp_port()
    simulator = [sys.executable, "-m", "panoexec", "simulate", "--port", str(port)]
    with running_broker(folder) as broker, (folder / "simulator.log").open("wb") as log:
        process = subprocess.Popen(simulator, stdout=log, stderr=log)
        try:
            yield Machine(broker=broker, port=port, package=package)
        finally:
            process.terminate()
            process.wait(30)
            DROP_IN.unlink(missing_ok=True)
            sh("dpkg", "--purge", "panoexec", check=False)


def _built() -> Path:
    sh("make", "-C", str(ROOT), "deb")
    return max((ROOT / "dist").glob("panoexec_*.deb"), key=lambda path: path.stat().st_mtime)


def test_the_same_commit_gives_the_same_package(machine: Machine, tmp_path: Path) -> None:
    if os.environ.get("PANOEXEC_DEB") or sh("git", "-C", str(ROOT), "status", "--porcelain"):
        pytest.skip("the package is not of a commit of this clone")
    clone = tmp_path / "clone"
    sh("git", "clone", "--quiet", str(ROOT), str(clone))
    sh("make", "-C", str(clone), "deb")
    assert (clone / "dist" / machine.package.name).read_bytes() == machine.package.read_bytes()


def test_an_installed_package_runs_by_itself(machine: Machine) -> None:
    sh("dpkg", "--install", str(machine.package))
    # Type=notify: the unit is active once the daemon has said READY
    wait("started", running)
    assert sh("systemctl", "is-enabled", UNIT).strip() == "enabled"
    assert sh("panoexec", "--version").startswith("panoexec ")
    sh("panoexec", "check-config", str(CONFIG))
    # sentences, where a log of JSON documents would begin with a brace
    logged = sh("journalctl", "--unit", UNIT, "--output", "json").splitlines()
    ready = next(entry for line in logged if (entry := json.loads(line)).get("PANO_EVENT") == "ready")
    assert ready["MESSAGE"].startswith("ready (vehicle drone")
    for place in ("man/man1/panoexec.1.gz", "bash-completion/completions/panoexec", "doc/panoexec/docs/pilot.md"):
        assert Path("/usr/share", place).is_file()
    account = pwd.getpwnam("panoexec")
    assert account.pw_uid < 1000
    assert (STATE.stat().st_uid, STATE.stat().st_mode & 0o777) == (account.pw_uid, 0o750)
    assert (CONFIG.parent.stat().st_gid, CONFIG.parent.stat().st_mode & 0o777) == (account.pw_gid, 0o750)


def test_it_starts_at_boot(machine: Machine) -> None:
    sh("systemctl", "stop", UNIT)
    machine.configure()
    DROP_IN.parent.mkdir(parents=True, exist_ok=True)
    DROP_IN.write_text(f"[Service]\nWatchdogSec={WATCHDOG_S}\nRestartSec=1\nTimeoutAbortSec=5\n")
    sh("systemctl", "daemon-reload")
    # what a boot does in its end
    sh("systemctl", "start", "multi-user.target")
    wait("started with the target", running)
    wait("vehicle found", lambda: show("StatusText") == "idle; vehicle ready")
    assert int(show("NRestarts")) == 0


async def test_killed_in_a_mission_it_is_restarted_and_goes_on(machine: Machine) -> None:
    async with ground_station(machine.broker) as ground:
        await ground.until(lambda: ground.state.get("reason") == "" and ground.status == "online")
        start = await ground.ask("start", "kill", **SMALL)
        assert start["status"] == "ok", start
        await ground.until(lambda: "shot_accepted" in ground.types())
        text = f"/{start['data']['images']} of {start['data']['mission_id']}"
        await ground.until(lambda: show("StatusText").startswith("capturing: shot ") and text in show("StatusText"))
        restarts, boot = int(show("NRestarts")), ground.state["boot_id"]
        os.kill(int(show("MainPID")), signal.SIGKILL)
        await ground.until(lambda: ground.state["boot_id"] != boot)
        await ground.until(lambda: ground.state["state"] == "complete", 120)
        assert int(show("NRestarts")) == restarts + 1
        assert ground.state["mission_id"] == start["data"]["mission_id"]
    mission = STATE / "missions" / start["data"]["mission_id"]
    wait("manifest", lambda: _manifest(start)["state"] == "complete")
    wait("files for stitchers", (mission / "panorama.pto").exists)


def test_the_watchdog_restarts_it_when_its_loop_is_frozen(machine: Machine) -> None:
    restarts = int(show("NRestarts"))
    frozen = int(show("MainPID"))
    os.kill(frozen, signal.SIGSTOP)
    wait("restarted by the watchdog", lambda: int(show("NRestarts")) == restarts + 1, 3 * WATCHDOG_S + 30)
    wait("running again", running)
    assert int(show("MainPID")) != frozen


async def test_stopped_in_a_mission_it_says_offline_and_leaves_it_to_be_resumed(machine: Machine) -> None:
    machine.configure(resume="offer")
    sh("systemctl", "restart", UNIT)
    async with ground_station(machine.broker) as ground:
        await ground.until(lambda: ground.state.get("reason") == "" and ground.status == "online")
        start = await ground.ask("start", "stop", **SMALL)
        assert start["status"] == "ok", start
        await ground.until(lambda: ground.state["shots_done"] >= 1 and ground.state["state"] == "capturing")
        await asyncio.to_thread(sh, "systemctl", "stop", UNIT)
        await ground.until(lambda: ground.status == "offline")
        assert show("Result") == "success"
        manifest = _manifest(start)
        assert manifest["state"] == "paused"
        boot = ground.state["boot_id"]
        await asyncio.to_thread(sh, "systemctl", "start", UNIT)
        await ground.until(lambda: ground.state["boot_id"] != boot and ground.status == "online")
        await ground.until(lambda: ground.state["resumable"] == start["data"]["mission_id"])
        await ground.until(lambda: ground.state["reason"] == "the mission was interrupted and can be resumed")
        await ground.until(lambda: all(link["ok"] for link in ground.state["link"].values()))
        assert (await ground.ask("resume", "go on"))["status"] == "ok"
        await ground.until(lambda: ground.state["state"] == "complete", 120)
    wait("manifest", lambda: _manifest(start)["state"] == "complete")


def _manifest(start: dict[str, Any]) -> dict[str, Any]:
    path = STATE / "missions" / start["data"]["mission_id"] / "manifest.json"
    document: dict[str, Any] = json.loads(path.read_text())
    return document


async def test_a_reload_reads_the_configuration_again(machine: Machine) -> None:
    pid = show("MainPID")
    async with ground_station(machine.broker) as ground:
        before = await ground.ask("plan", "before", method="paper")
        machine.configure("elevation_deg = [-20, 0]\n")
        sh("systemctl", "reload", UNIT)
        for attempt in range(100):
            after = await ground.ask("plan", f"after {attempt}", method="paper")
            if after["data"]["images"] < before["data"]["images"]:
                break
        else:
            pytest.fail("the new band is not used")
    assert show("MainPID") == pid
    wait("running after the reload", running)


async def test_the_planner_runs_behind_the_daemon_and_is_what_the_kernel_ends(machine: Machine) -> None:
    daemon, restarts = int(show("MainPID")), show("NRestarts")
    assert os.getpriority(os.PRIO_PROCESS, daemon) == -5
    # in a container the kernel may refuse a negative score, and systemd goes on without
    assert _oom_score(daemon) == -500 or sh("systemd-detect-virt", "--container", check=False).strip() != "none"
    async with ground_station(machine.broker) as ground:
        await ground.until(lambda: ground.status == "online")
        await ground.send("plan", json.dumps({"transaction": "slow", **SLOW}).encode())
        await ground.until(lambda: _children(daemon) and _oom_score(_children(daemon)[0]) == 900)
        (planner,) = _children(daemon)
        # the filter of system calls lets the planner lower its priority
        assert os.getpriority(os.PRIO_PROCESS, planner) == 0
        group = _memory_group(planner)
        if group is None:
            os.kill(planner, signal.SIGKILL)  # as the kernel does
        else:
            room = int((group / "memory.current").read_text()) + 2**20
            sh("systemctl", "set-property", "--runtime", UNIT, f"MemoryMax={room}")
        await ground.until(lambda: "slow" in ground.answers)
        assert ground.answers["slow"]["error"]["code"] == "planning_budget", ground.answers["slow"]
        if group is not None:
            events = dict(line.split() for line in (group / "memory.events").read_text().splitlines())
            assert int(events["oom_kill"]) >= 1
            sh("systemctl", "set-property", "--runtime", UNIT, "MemoryMax=750M")
        assert (await ground.ask("get", "lives"))["status"] == "ok"
    assert running()
    assert (int(show("MainPID")), show("NRestarts")) == (daemon, restarts)


def _children(pid: int) -> list[int]:
    return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def _oom_score(pid: int) -> int:
    return int(Path(f"/proc/{pid}/oom_score_adj").read_text())


def _memory_group(pid: int) -> Path | None:
    """The control group (version 2) that limits the memory of a process; None where there is none."""
    unified = next(line for line in Path(f"/proc/{pid}/cgroup").read_text().splitlines() if line.startswith("0::"))
    group = Path("/sys/fs/cgroup") / unified.removeprefix("0::/")
    return group if (group / "memory.current").exists() else None


def test_a_wrong_configuration_is_told_once_and_not_tried_again(machine: Machine) -> None:
    machine.configure('[log]\nlevel = "shout"\n')
    with pytest.raises(AssertionError):
        sh("systemctl", "restart", UNIT)
    assert (show("ActiveState"), show("SubState"), show("ExecMainStatus")) == ("failed", "failed", "78")
    # what systemd would start again is `activating` (auto-restart) and never `failed`
    machine.configure()
    sh("systemctl", "start", UNIT)


async def test_an_upgrade_in_a_mission_keeps_configuration_and_missions_and_goes_on(
    machine: Machine, tmp_path: Path
) -> None:
    newer = _newer(machine.package, tmp_path)
    pid = show("MainPID")
    async with ground_station(machine.broker) as ground:
        await ground.until(lambda: ground.state.get("reason") == "" and ground.status == "online")
        start = await ground.ask("start", "upgrade", **SMALL)
        assert start["status"] == "ok", start
        await ground.until(lambda: "shot_accepted" in ground.types())
        missions = sorted(path.name for path in (STATE / "missions").iterdir())
        assert len(missions) == 3
        # both sides have changed the configuration: dpkg would ask, and keeps the administrator's unless told otherwise
        await asyncio.to_thread(sh, "dpkg", "--install", "--force-confold", str(newer))
        wait("started after the upgrade", running)
        assert show("MainPID") != pid
        await ground.until(lambda: "mission_paused" in ground.types(), 10)
        # [mission] resume = "auto": the new version goes on with what the old one stopped after its photo
        await ground.until(lambda: ground.state["state"] == "complete", 120)
        assert ground.state["mission_id"] == start["data"]["mission_id"]
    assert "+test" in sh("dpkg-query", "--show", "panoexec")
    assert CONFIG.read_text().startswith(EDITED)
    assert sorted(path.name for path in (STATE / "missions").iterdir()) == missions
    for mission in missions:
        assert (STATE / "missions" / mission / "journal.sqlite").stat().st_size > 0


def test_a_unit_that_does_not_start_is_told_in_a_sentence(machine: Machine) -> None:
    broken = DROP_IN.with_name("broken.conf")
    broken.write_text("[Service]\nExecStartPre=/bin/false\nRestart=no\n")
    sh("systemctl", "daemon-reload")
    installed = ("dpkg", "--install", "--force-confold", str(machine.package))
    done = subprocess.run(installed, capture_output=True, text=True, check=False, env=os.environ | {"LC_ALL": "C"})
    assert done.returncode == 0, done.stderr
    assert f"panoexec: {UNIT} has not started yet" in done.stderr
    assert "Could not execute" not in done.stderr
    broken.unlink()
    sh("systemctl", "daemon-reload")
    sh("systemctl", "start", UNIT)


def _status(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/status").read_text().splitlines()


def _newer(package: Path, folder: Path) -> Path:
    """The same with a higher version and another configuration, as a release has."""
    tree, out = folder / "tree", folder / "newer.deb"
    sh("dpkg-deb", "--raw-extract", str(package), str(tree))
    control = tree / "DEBIAN" / "control"
    lines = control.read_text().splitlines()
    control.write_text("\n".join(f"{x}+test" if x.startswith("Version:") else x for x in lines) + "\n")
    shipped = tree / "etc/panoexec/config.toml"
    shipped.write_text(shipped.read_text() + "# new in this version\n")
    sh("dpkg-deb", "--root-owner-group", "-Zgzip", "-z1", "--build", str(tree), str(out))
    return out


def test_removed_it_leaves_configuration_and_missions_purged_nothing(machine: Machine) -> None:
    drop_in = Path(f"/etc/systemd/system/{UNIT}.d/serial.conf")
    drop_in.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy("/usr/share/panoexec/serial.conf", drop_in)
    DROP_IN.unlink()
    sh("systemctl", "daemon-reload")
    sh("systemctl", "restart", UNIT)
    groups = next(line for line in _status(int(show("MainPID"))) if line.startswith("Groups:")).split()
    assert str(grp.getgrnam("dialout").gr_gid) in groups, "it may open serial ports"
    sh("dpkg", "--remove", "panoexec")
    assert show("ActiveState") == "inactive"
    assert CONFIG.exists()
    assert (STATE / "missions").is_dir()
    sh("dpkg", "--purge", "panoexec")
    nothing_left()
    with pytest.raises(KeyError):
        pwd.getpwnam("panoexec")
