"""The client of the process that examines photos (`panoexec.pictures.worker`); it needs no Pillow."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import json
import math
import os
import sys
from collections.abc import AsyncIterator, Collection, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final, Self

from panoexec.errors import DeviceError
from panoexec.optics import Camera
from panoexec.pictures.model import BridgePose, Content, Judgement, TieGraph, TieLine, Verdicts

_LINE_LIMIT: Final = 1 << 24
_END_S: Final = 3.0
_ANSWER_S: Final = 60.0
"""Longest wait for one photo: a process that takes longer is stuck, not busy."""


class PictureProcess:
    """A running examination; one request at a time."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self._turn = asyncio.Lock()

    @classmethod
    @asynccontextmanager
    async def running(cls, camera: Camera) -> AsyncIterator[Self]:
        """Start the process; it is ended with the block.

        Args:
            camera: whose photos are examined.
        """
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "panoexec.pictures.worker",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            limit=_LINE_LIMIT,
            # small matrices: a second thread costs half as much again and gains nothing
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )
        checker = cls(process)
        try:
            await checker._ask({"camera": dataclasses.asdict(camera)})
            yield checker
        finally:
            await checker._end()

    @property
    def pid(self) -> int:
        """The process's id."""
        return self._process.pid

    async def plan(self, planned: Mapping[int, Sequence[float]]) -> None:
        """Tell planned attitudes, quaternions `[w, x, y, z]` by shot.

        Raises:
            DeviceError: the process failed.
        """
        await self._ask({"planned": {str(shot): list(q) for shot, q in planned.items()}})

    async def add(
        self, shot: int, path: Path, q_wxyz: Sequence[float], time_s: float, place: Sequence[float] | None = None
    ) -> Verdicts:
        """Examine a photo; it replaces an earlier one of the same shot.

        Args:
            shot: its number.
            path: its file.
            q_wxyz: measured attitude.
            time_s: when it was taken, on any clock.
            place: where, as in `PhotoToCheck`.

        Raises:
            DeviceError: the process failed.
        """
        more = {"path": str(path), "place": None if place is None else list(place)}
        return await self._ask({"add": _photo(shot, q_wxyz, time_s) | more})

    async def condemn(self, shot: int, code: Content, reason: str, q_wxyz: Sequence[float], time_s: float) -> Verdicts:
        """Add a photo that is bad for a reason that others found.

        Raises:
            DeviceError: the process failed.
        """
        return await self._ask({"add": _photo(shot, q_wxyz, time_s) | {"problem": [code.value, reason]}})

    async def drop(self, shots: Sequence[int]) -> Verdicts:
        """Forget photos.

        Raises:
            DeviceError: the process failed.
        """
        return await self._ask({"drop": list(shots)})

    async def judge(self, *, final: bool = False) -> Verdicts:
        """The verdicts on all photos; `final`: no more are to come.

        Raises:
            DeviceError: the process failed.
        """
        return await self._ask({"final": final})

    async def bridges(
        self, *, tried: Collection[frozenset[int]], pitch_deg: tuple[float, float], most: int
    ) -> list[BridgePose]:
        """Poses that may tie photos which share too little (`panoexec.pictures.bridging.bridge_poses`).

        Raises:
            DeviceError: the process failed.
        """
        asked = {"tried": [sorted(pair) for pair in tried], "pitch_deg": list(pitch_deg), "most": most}
        answer = await self._exchange({"bridges": asked})
        return [
            BridgePose(between=(a, b), pitch_deg=pitch, yaw_deg=yaw, corners=corners)
            for a, b, pitch, yaw, corners in answer["bridges"]
        ]

    async def _ask(self, request: dict[str, Any]) -> Verdicts:
        return _verdicts(await self._exchange(request))

    async def _exchange(self, request: dict[str, Any]) -> dict[str, Any]:
        async with self._turn:
            stdin, stdout = self._process.stdin, self._process.stdout
            assert stdin is not None
            assert stdout is not None
            try:
                stdin.write(json.dumps(request).encode() + b"\n")
                await stdin.drain()
                async with asyncio.timeout(_ANSWER_S):
                    line = await stdout.readline()
            except (OSError, ValueError, TimeoutError) as error:
                self._kill()
                raise DeviceError(f"the examination of photos failed: {type(error).__name__} {error}") from error
        if not line:
            raise DeviceError("the process that examines photos has ended")
        answer: dict[str, Any] = json.loads(line)
        if problem := answer.get("error"):
            raise DeviceError(f"the examination of photos failed: {problem}")
        return answer

    def _kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()

    async def _end(self) -> None:
        process = self._process
        assert process.stdin is not None
        process.stdin.close()
        try:
            async with asyncio.timeout(_END_S):
                await process.wait()
        except TimeoutError:
            self._kill()
            await process.wait()


def _photo(shot: int, q_wxyz: Sequence[float], time_s: float) -> dict[str, Any]:
    return {"shot": shot, "q_wxyz": list(q_wxyz), "time_s": time_s if math.isfinite(time_s) else None}


def _verdicts(answer: Mapping[str, Any]) -> Verdicts:
    graph = answer["graph"]
    photos = {
        entry["shot"]: Judgement(
            shot=entry["shot"],
            verdict=Content(entry["verdict"]),
            reason=entry["reason"],
            settled=entry["settled"],
            sharpness=math.nan if entry["sharpness"] is None else entry["sharpness"],
            stops=math.nan if entry["stops"] is None else entry["stops"],
            odd_deg=entry["odd_deg"],
            error_deg=(entry["error_deg"][0], entry["error_deg"][1], entry["error_deg"][2]),
            ties=tuple(
                TieLine(shot=shot, points=points, angle_deg=angle, parallax_deg=parallax)
                for shot, points, angle, parallax in entry["ties"]
            ),
        )
        for entry in answer["photos"]
    }
    return Verdicts(
        photos=photos,
        graph=TieGraph(
            photos=tuple(graph["photos"]),
            edges=tuple((a, b, points) for a, b, points in graph["edges"]),
            groups=tuple(tuple(group) for group in graph["groups"]),
            bridges=tuple((a, b) for a, b in graph["bridges"]),
            geometry_only=tuple(graph["geometry_only"]),
        ),
    )
