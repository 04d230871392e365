"""The shipped unit: how exposed it leaves the service, as systemd itself judges."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

UNITS = Path(__file__).parents[2] / "systemd"

pytestmark = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


@pytest.mark.parametrize(("drop_in", "most"), [(False, 1.5), (True, 2.0)])
def test_exposure(tmp_path: Path, drop_in: bool, most: float) -> None:
    unit = Path(shutil.copy(UNITS / "panoexec.service", tmp_path))
    if drop_in:
        (tmp_path / "panoexec.service.d").mkdir()
        shutil.copy(UNITS / "serial.conf", tmp_path / "panoexec.service.d")
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", str(unit)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = re.search(r"Overall exposure level for panoexec.service: ([\d.]+)", out)
    assert found is not None, out
    assert float(found[1]) <= most
    # the drop-in opens devices, so it must show
    assert drop_in == (float(found[1]) > 1.5)
