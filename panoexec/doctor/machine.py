"""Checks of the computer: clock, disk, permissions of the user."""

from __future__ import annotations

import contextlib
import ctypes
import os
import pwd
import shutil
import statistics
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from panoexec.adapters.link.connection_url import parse_connection
from panoexec.doctor.findings import Findings
from panoexec.errors import UsageError
from panoexec.inputs.config import Config
from panoexec.store.directory import mission_directories

_SLOW_SYNC_S: Final = 0.25
_SYNCS: Final = 5
_TIME_ERROR: Final = 5
_TIMEX_BYTES: Final = 512
_RELEASED: Final = datetime(2026, 1, 1, tzinfo=UTC).timestamp()
"""Release date of panoexec: a correct clock shows a later time."""


def check_machine(config: Config, config_file: Path, findings: Findings) -> None:
    """Check clock, disk and permissions. Blocking; writes a small file into the storage and removes it."""
    check_clock(config.storage.path, findings)
    check_disk(config, findings)
    check_permissions(config, config_file, findings)


# --- clock


def check_clock(storage: Path, findings: Findings) -> None:
    """Check that the wall clock is plausible: names of missions, times of photos and TLS depend on it, nothing else."""
    now = time.time()
    shown = datetime.fromtimestamp(now, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    advice = (
        "set it, or synchronise it: systemd-timesyncd, chrony, or a battery-backed clock for a machine without network"
    )
    newest = _newest_mission(storage)
    if now < _RELEASED:
        needed = f"after {datetime.fromtimestamp(_RELEASED, UTC):%Y}: names and times of photos are wrong, TLS fails"
        findings.warning("clock", "date", shown, needed=needed, advice=advice)
    elif newest and newest > datetime.fromtimestamp(now, UTC).strftime("%Y%m%dT%H%M%S"):
        needed = f"after the newest name of a mission, {newest}: it was set back since, or was wrong then"
        findings.warning("clock", "date", shown, needed=needed, advice=advice)
    else:
        findings.ok("clock", "date", shown)
    synchronised = clock_synchronised()
    if synchronised is None:
        findings.note("clock", "synchronised", "unknown: the system does not report it")
    elif synchronised:
        findings.ok("clock", "synchronised", "yes")
    else:
        findings.warning("clock", "synchronised", "no", needed="accurate times of photos", advice=advice)


def clock_synchronised() -> bool | None:
    """Whether a time service synchronises the kernel's clock (adjtimex(2)); None if unknown."""
    try:
        # a struct timex of zeros only queries
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (OSError, AttributeError):
        return None
    return None if state < 0 else state != _TIME_ERROR


def _newest_mission(storage: Path) -> str:
    try:
        missions = mission_directories(storage)
    except OSError:
        return ""
    return missions[-1].mission_id if missions else ""


# --- disk


def check_disk(config: Config, findings: Findings) -> None:
    """Check that missions can be stored, and measure the time of an fsync."""
    section = config.storage
    try:
        section.path.mkdir(parents=True, exist_ok=True)
        sync_s = _sync_time(section.path)
        free_mb = shutil.disk_usage(section.path).free / 1e6
    except OSError as error:
        findings.missing(
            "disk",
            "storage",
            f"{section.path}: {error.strerror}",
            needed="a writable folder",
            advice=f"[storage] path, or give {section.path} to the service's user (now {_user()})",
        )
        return
    findings.ok("disk", "storage", f"{section.path} is writable")
    findings.judge(
        "disk",
        "room",
        free_mb >= section.min_free_mb,
        f"{free_mb:.0f} MB free",
        needed=f"{section.min_free_mb:g} MB",
        advice="delete old missions, or [storage] min_free_mb",
    )
    text = f"{1000 * sync_s:.1f} ms to write a journal record (fsync)"
    if sync_s > _SLOW_SYNC_S:
        findings.warning(
            "disk", "speed", text, needed=f"below {1000 * _SLOW_SYNC_S:g} ms", advice="[storage] path on a faster disk"
        )
    else:
        findings.ok("disk", "speed", text)


def _sync_time(folder: Path) -> float:
    """Median seconds of a small write with fsync."""
    times = []
    descriptor, name = tempfile.mkstemp(dir=folder, prefix=".doctor-")
    try:
        for _ in range(_SYNCS):
            begin = time.monotonic()
            os.write(descriptor, b"x" * 512)
            os.fsync(descriptor)
            times.append(time.monotonic() - begin)
    finally:
        os.close(descriptor)
        with contextlib.suppress(OSError):
            Path(name).unlink()
    return statistics.median(times)


# --- permissions


def check_permissions(config: Config, config_file: Path, findings: Findings) -> None:
    """Check what this user may do, and that it is the service's user."""
    owner = _owner(config.storage.path)
    if os.geteuid() == 0 and owner not in ("", "root"):
        # the service has this group by its drop-in for serial ports, its user alone does not
        groups = f" -g {owner} -G dialout" if config.vehicle.serial or _devices(config) else ""
        findings.warning(
            "permissions",
            "user",
            f"root, but {config.storage.path} belongs to {owner}",
            needed="a check as the service's user: root has all permissions",
            advice=f"runuser -u {owner}{groups} -- panoexec doctor --config {config_file}",
        )
    else:
        findings.note("permissions", "user", _user())
    for name, path in _devices(config):
        _examine_device(name, path, findings)


def _devices(config: Config) -> list[tuple[str, Path]]:
    """Serial devices named in the configuration."""
    vehicle, camera = config.vehicle, config.camera
    out = []
    if vehicle.connection is not None:
        with contextlib.suppress(UsageError):
            url = parse_connection(vehicle.connection)
            if url.kind == "serial":
                out.append(("vehicle.connection", Path(url.path)))
    if vehicle.serial not in (None, "auto"):
        out.append(("vehicle.serial", Path(str(vehicle.serial))))
    if camera.trigger == "serial" and camera.serial_port is not None:
        out.append(("camera.serial_port", Path(camera.serial_port)))
    return out


def _examine_device(name: str, path: Path, findings: Findings) -> None:
    if not path.exists():
        findings.missing(
            "permissions", name, f"{path} does not exist", advice="connect it, or use its name in /dev/serial/by-id/"
        )
        return
    group = path.group()
    findings.judge(
        "permissions",
        name,
        os.access(path, os.R_OK | os.W_OK),
        f"{path} of group {group}, used by {_user()}",
        needed="read and write permission",
        advice=f"usermod -aG {group} {_user()}; the service: systemd/serial.conf",
    )


def _user() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return f"user {os.geteuid()}"


def _owner(path: Path) -> str:
    try:
        return path.owner()
    except (OSError, KeyError):
        return ""
