"""Commands compute with one thread: numpy's others would wait for each other on a busy machine."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

RUN = """
import os, sys
from panoexec.__main__ import main
assert "numpy" not in sys.modules
sys.argv = ["panoexec", "plan", "--camera", "dji-x5s-15mm", "--elevation", "-90", "-80", "--output", os.devnull]
try:
    main()
except SystemExit:
    pass
import numpy as np
np.linalg.solve(np.eye(400), np.ones(400))
print(len(os.listdir("/proc/self/task")), os.environ["OPENBLAS_NUM_THREADS"])
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted in /proc")
@pytest.mark.parametrize(("set_to", "threads"), [(None, "1"), ("2", "2")])
def test_a_command_has_one_thread_unless_it_is_set_otherwise(set_to: str | None, threads: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment |= {} if set_to is None else {"OPENBLAS_NUM_THREADS": set_to}
    done = subprocess.run(
        [sys.executable, "-c", RUN], env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    counted, variable = done.stdout.split()[-2:]
    assert variable == threads
    if set_to is None:
        assert counted == "1"
