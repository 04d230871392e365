"""Thumbnails of stored photos: made by a process of low priority, kept with the mission, published as MQTT has room.

They may be lost: QoS 0, the newest first, only while nothing else waits, within a budget of bytes a second. A ground
station that missed some asks for them again.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import structlog

from panoexec.daemon.errors import MissionStorageError
from panoexec.inputs.config import Config
from panoexec.mission.log.events import Event, PhotoStored
from panoexec.mqtt.link import MqttLink
from panoexec.store.directory import mission_directories

FOLDER: Final = "thumbnails"
_QUEUE: Final = 2_000
_MAKE_S: Final = 60.0
_IDLE_S: Final = 30.0
_RETRY_S: Final = 0.5

_log = structlog.get_logger(__name__)

_Key = tuple[str, int]
"""Mission id and shot."""


class Thumbnails:
    """Makes and publishes thumbnails in `run`, which is one task of the daemon."""

    def __init__(self, *, config: Callable[[], Config], mqtt: MqttLink | None) -> None:
        """Describe it.

        Args:
            config: as of now.
            mqtt: where they are published; None without a broker.
        """
        self._config = config
        self._mqtt = mqtt
        self._to_make: dict[_Key, str] = {}
        self._to_send: dict[_Key, Path] = {}
        self._news = asyncio.Event()
        self._process: asyncio.subprocess.Process | None = None
        self._free_s = 0.0

    def publish(self, event: Event) -> None:
        """Note a stored photo (`EventSink`)."""
        if isinstance(event, PhotoStored) and event.photo == 1 and self._config().pictures.thumbnails != "off":
            _put(self._to_make, (event.mission_id, event.shot), event.file)
            self._news.set()

    async def send_again(self, mission_id: str, shots: Sequence[int] | None) -> int:
        """Publish thumbnails that exist once more, in the order of the shots; returns how many.

        Args:
            mission_id: whose.
            shots: which; None for all.

        Raises:
            MissionStorageError: there is no such mission.
        """
        found = await asyncio.to_thread(self._existing, mission_id)
        wanted = found.keys() if shots is None else found.keys() & set(shots)
        chosen = sorted(wanted, reverse=True)
        for shot in chosen:
            _put(self._to_send, (mission_id, shot), found[shot])
        self._news.set()
        return len(chosen)

    def _existing(self, mission_id: str) -> dict[int, Path]:
        folder = self._folder(mission_id)
        if folder is None:
            raise MissionStorageError(f"there is no mission {mission_id} in {self._config().storage.path}")
        return {int(path.stem): path for path in folder.glob("*.jpg") if path.stem.isdigit()}

    async def run(self) -> None:
        """Make and publish until cancelled."""
        try:
            while True:
                self._news.clear()
                if self._to_make:
                    await self._make()
                sent = await self._send()
                if self._to_make or sent:
                    continue
                pause_s = _RETRY_S if self._to_send and self._mqtt is not None else _IDLE_S
                try:
                    async with asyncio.timeout(pause_s):
                        await self._news.wait()
                except TimeoutError:
                    if not self._to_send:
                        await self._end_process()
        finally:
            await self._end_process()

    async def _make(self) -> None:
        """Make the newest one."""
        key, file = self._to_make.popitem()
        folder = await asyncio.to_thread(self._folder, key[0])
        if folder is None:
            return
        path = folder / f"{key[1]}.jpg"
        problem = await self._made(folder.parent / file, path)
        if problem:
            _log.warning("no thumbnail", mission_id=key[0], shot=key[1], problem=problem)
        elif self._config().pictures.thumbnails == "mqtt":
            _put(self._to_send, key, path)

    async def _made(self, photo: Path, path: Path) -> str:
        """Have one made; returns why that failed, "" if it did not."""
        process = await self._started()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps({"photo": str(photo), "thumbnail": str(path)}).encode() + b"\n")
            async with asyncio.timeout(_MAKE_S):
                answer = json.loads(await process.stdout.readline())
        except (OSError, ValueError, TimeoutError) as error:
            await self._end_process()
            return f"the process that makes it failed ({type(error).__name__})"
        return str(answer["error"])

    async def _send(self) -> bool:
        """Publish the newest one if budget and link permit; returns whether it was."""
        now, mqtt = time.monotonic(), self._mqtt
        if not self._to_send or mqtt is None or now < self._free_s:
            return False
        key = next(reversed(self._to_send))
        path = self._to_send[key]
        try:
            payload = await asyncio.to_thread(path.read_bytes)
        except OSError:
            self._to_send.pop(key, None)
            return False
        if not await mqtt.publish_spare(mqtt.topics.thumbnail(*key), payload):
            return False
        self._to_send.pop(key, None)
        self._free_s = now + len(payload) / self._config().pictures.thumbnail_bytes_s
        return True

    def _folder(self, mission_id: str) -> Path | None:
        storage = self._config().storage.path
        directory = next((one for one in mission_directories(storage) if one.mission_id == mission_id), None)
        return None if directory is None else directory.path / FOLDER

    async def _started(self) -> asyncio.subprocess.Process:
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                "panoexec.daemon.thumbnail_worker",
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is for the parent
            )
        return self._process

    async def _end_process(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()


def _put(queue: dict[_Key, str] | dict[_Key, Path], key: _Key, value: object) -> None:
    """Put it last, where the next one is taken; beyond the limit the oldest ones are dropped."""
    queue.pop(key, None)
    queue[key] = value  # type: ignore[assignment]
    while len(queue) > _QUEUE:
        del queue[next(iter(queue))]
