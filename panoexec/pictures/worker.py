"""The process that examines photos: one JSON object per line comes in, one goes out (`panoexec.pictures.process`).

It runs at low priority beside the daemon, and is the first that the kernel ends when the computer runs out of memory.
It ends with its standard input, so it never outlives its parent.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import math
import os
import signal
import sys
from pathlib import Path
from typing import Any, Final

_NICE: Final = 10
_OOM_SCORE: Final = 850
_PR_SET_PDEATHSIG: Final = 1


def main() -> None:
    """Obey until the end of standard input."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides when to exit
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    with contextlib.suppress(OSError):  # a sandbox may deny both
        os.nice(_NICE)
        Path("/proc/self/oom_score_adj").write_text(str(_OOM_SCORE), encoding="ascii")
    session = _Session()
    for line in sys.stdin:
        try:
            answer = session.obey(json.loads(line))
        except Exception as error:  # noqa: BLE001  (one photo must not end the examination of all others)
            answer = {"error": f"{type(error).__name__}: {error}"}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


class _Session:
    def __init__(self) -> None:
        from panoexec.pictures.examiner import Examiner  # noqa: PLC0415  (the priority is lowered before)

        self._kind = Examiner
        self._examiner: Any = None

    def obey(self, request: dict[str, Any]) -> dict[str, Any]:
        """Carry out a request."""
        import numpy as np  # noqa: PLC0415

        from panoexec.angles import rotation_from_quaternion  # noqa: PLC0415
        from panoexec.optics import Camera  # noqa: PLC0415
        from panoexec.pictures.model import PhotoToCheck  # noqa: PLC0415

        if "camera" in request:
            self._examiner = self._kind(Camera.from_plain(request["camera"]))
        for shot in request.get("drop", ()):
            self._examiner.drop(shot)
        if planned := request.get("planned"):
            self._examiner.plan({int(shot): rotation_from_quaternion(q) for shot, q in planned.items()})
        if add := request.get("add"):
            time_s = math.nan if add["time_s"] is None else float(add["time_s"])
            rotation = rotation_from_quaternion(add["q_wxyz"])
            place = None if add.get("place") is None else np.array(add["place"], dtype=np.float64)
            photo = PhotoToCheck(shot=add["shot"], rotation=rotation, time_s=time_s, place=place)
            if problem := add.get("problem"):
                self._examiner.condemn(photo, *problem)
            else:
                try:
                    content = Path(add["path"]).read_bytes()
                except OSError as error:
                    self._examiner.condemn(photo, "unreadable", f"cannot be read ({error.strerror})")
                else:
                    self._examiner.add(photo, content)
        if bridges := request.get("bridges"):
            low, high = bridges["pitch_deg"]
            tried = {frozenset(pair) for pair in bridges["tried"]}
            found = self._examiner.bridges(tried=tried, pitch_deg=(low, high), most=bridges["most"])
            return {"bridges": [[*one.between, one.pitch_deg, one.yaw_deg, one.corners] for one in found]}
        return self._verdicts(final=bool(request.get("final")))

    def _verdicts(self, *, final: bool) -> dict[str, Any]:
        found = self._examiner.verdicts(final=final)
        graph = found.graph
        return {
            "photos": [
                {
                    "shot": judged.shot,
                    "verdict": judged.verdict.value,
                    "reason": judged.reason,
                    "settled": judged.settled,
                    "sharpness": _number(judged.sharpness),
                    "stops": _number(judged.stops),
                    "odd_deg": judged.odd_deg,
                    "error_deg": list(judged.error_deg),
                    "ties": [[tie.shot, tie.points, tie.angle_deg, tie.parallax_deg] for tie in judged.ties],
                }
                for judged in found.photos.values()
            ],
            "graph": {
                "photos": graph.photos,
                "edges": graph.edges,
                "groups": graph.groups,
                "bridges": graph.bridges,
                "geometry_only": graph.geometry_only,
            },
        }


def _number(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None


if __name__ == "__main__":
    main()
