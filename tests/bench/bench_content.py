"""The examination of photos: processor time and memory of a photo, and what of the faults is found."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import PIL.Image

from panoexec.angles import quaternion_from_rotation
from panoexec.pictures.decoding import decode
from panoexec.pictures.features import features_of
from tests.bench.harness import Measurement
from tests.support.content_campaign import campaign_plans, run
from tests.support.photo_sets import PhotoSet, photo_set

MISSIONS = 6
PHOTO_S, LARGE_S, MEMORY_MB = 0.15, 0.25, 150.0


def measure() -> Iterable[Measurement]:
    """Examine missions with known truth."""
    plan = campaign_plans()[0]
    photos = photo_set(plan, scene_seed=900, seed=1, width_px=1000)
    cpu_s, memory_mb = _in_a_process(photos)
    yield Measurement(
        what="processor time of a photo of 1000 px",
        ours=cpu_s,
        unit="s",
        goal=f"at most {PHOTO_S}",
        met=cpu_s <= PHOTO_S,
    )
    yield Measurement(
        what="memory of the process",
        ours=memory_mb,
        unit="MB",
        goal=f"at most {MEMORY_MB:g}",
        met=memory_mb <= MEMORY_MB,
    )
    large_s = _large_photo_s(photos.photos[0].content) + cpu_s
    yield Measurement(
        what="the same of a photo of 24 megapixels",
        ours=large_s,
        unit="s",
        goal=f"at most {LARGE_S}",
        met=large_s <= LARGE_S,
    )
    tally = run(MISSIONS, seed=900)
    bad = sum(tally.put_in.values())
    found = sum(tally.found.values())
    yield Measurement(what=f"bad photos found of {bad}", ours=found, unit="photos", goal="all", met=found == bad)
    yield Measurement(
        what=f"needless retakes of {tally.clean} clean photos", ours=len(tally.alarms), unit="photos", goal="none",
        met=not tally.alarms,
    )  # fmt: skip
    share = 100 * tally.tied / max(1, tally.pairs)
    yield Measurement(what=f"of {tally.pairs} pairs tied", ours=share, unit="%", goal="at least 98", met=share >= 98)


def _in_a_process(photos: PhotoSet) -> tuple[float, float]:
    """Processor time a photo, and the greatest resident memory (MB) of the process that examines them."""
    with tempfile.TemporaryDirectory() as folder:
        requests = [json.dumps({"camera": asdict(photos.camera)})]
        for photo in photos.photos:
            path = Path(folder) / f"{photo.shot}.jpg"
            path.write_bytes(photo.content)
            q_wxyz = quaternion_from_rotation(photo.measured).tolist()
            add = {"shot": photo.shot, "path": str(path), "q_wxyz": q_wxyz, "time_s": photo.time_s}
            requests.append(json.dumps({"add": add}))
        with subprocess.Popen(
            [sys.executable, "-m", "panoexec.pictures.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        ) as worker:
            assert worker.stdin is not None
            assert worker.stdout is not None
            begun_s = 0.0
            for number, request in enumerate(requests):
                worker.stdin.write(request + "\n")
                worker.stdin.flush()
                worker.stdout.readline()
                if not number:
                    begun_s = _cpu_s(worker.pid)
            spent_s = _cpu_s(worker.pid) - begun_s
            status = Path(f"/proc/{worker.pid}/status").read_text(encoding="ascii")
            worker.stdin.close()
    peak_kb = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
    return spent_s / len(photos.photos), peak_kb / 1000


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _large_photo_s(content: bytes) -> float:
    """Processor time of decoding and measuring 24 megapixels, less that of a photo of 1000 px."""
    with PIL.Image.open(io.BytesIO(content)) as picture:
        large = picture.resize((6000, round(6000 * picture.height / picture.width)))
    rng = np.random.default_rng(1)
    noisy = np.clip(np.asarray(large, dtype=np.int16) + rng.integers(-9, 10, (large.height, 6000, 1)), 0, 255)
    buffer = io.BytesIO()
    PIL.Image.fromarray(noisy.astype(np.uint8)).save(buffer, "JPEG", quality=90)

    def spent(data: bytes) -> float:
        times = []
        for _ in range(3):
            start = time.process_time()
            features_of(decode(data, 1000).grey)
            times.append(time.process_time() - start)
        return min(times)

    return spent(buffer.getvalue()) - spent(content)
