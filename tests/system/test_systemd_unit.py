"""The shipped unit: how exposed it leaves the service, as systemd itself judges."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.repository import ROOT

UNITS = ROOT / "systemd"

pytestmark = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


def exposure(folder: Path, *drop_ins: str) -> float:
    unit = Path(shutil.copy(UNITS / "panoexec.service", folder))
    drop_in = folder / "panoexec.service.d"
    shutil.rmtree(drop_in, ignore_errors=True)
    drop_in.mkdir()
    for name in drop_ins:
        shutil.copy(UNITS / name, drop_in)
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", str(unit)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = re.search(r"Overall exposure level for panoexec.service: ([\d.]+)", out)
    assert found is not None, out
    return float(found[1])


def test_exposure(tmp_path: Path) -> None:
    alone = exposure(tmp_path)
    assert alone <= 1.5
    # a drop-in opens devices, so it must show
    assert alone < exposure(tmp_path, "serial.conf") <= 1.5
    assert alone < exposure(tmp_path, "gphoto2.conf") <= 2.0
    assert alone < exposure(tmp_path, "gphoto2.conf", "serial.conf") <= 2.0
