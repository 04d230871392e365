"""The files of a camera with an HTTP server; a process (`panoexec.adapters.files.http_worker`) downloads them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from panoexec.errors import PhotoFileError

MAX_BYTES: Final = 256 * 1024 * 1024
TIMEOUT_S: Final = 600.0
_START_S: Final = 60.0
"""For the process, which has low priority, to start; the time of a download begins afterwards."""
_GRACE_S: Final = 5.0
_EXIT_S: Final = 2.0


class HttpFiles:
    """Downloads photos, one at a time; implements `PhotoFetcher`."""

    source = "http"

    def __init__(
        self,
        hosts: Callable[[], Iterable[str]],
        *,
        max_bytes: int = MAX_BYTES,
        timeout_s: float = TIMEOUT_S,
        documents: bool = False,
    ) -> None:
        """Describe it; the process is started with the first download.

        Args:
            hosts: returns names or addresses of the only hosts that are asked.
            max_bytes: of one file.
            timeout_s: of one download.
            documents: texts are wanted; where a photo is, they are refused.
        """
        self._hosts = hosts
        self._max_bytes = max_bytes
        self._timeout_s = timeout_s
        self._documents = documents
        self._process: asyncio.subprocess.Process | None = None
        self._lock = asyncio.Lock()

    def takes(self, url: str) -> bool:
        """See `PhotoFetcher.takes`."""
        with contextlib.suppress(ValueError):
            return urlsplit(url).scheme in {"http", "https"}
        return False

    async def fetch(self, url: str, part: Path) -> Path:
        """See `PhotoFetcher.fetch`; a cancelled download can be continued later."""
        async with self._lock:
            process = await self._started()
            assert process.stdin is not None
            assert process.stdout is not None
            job = {
                "url": url,
                "part": str(part),
                "hosts": sorted({host.lower() for host in self._hosts()}),
                "max_bytes": self._max_bytes,
                "timeout_s": self._timeout_s,
                "documents": self._documents,
            }
            try:
                process.stdin.write(json.dumps(job).encode() + b"\n")
                async with asyncio.timeout(self._timeout_s + _GRACE_S):
                    line = await process.stdout.readline()
                answer = json.loads(line or "{}")
            except (OSError, ValueError, TimeoutError) as error:
                await self._killed()
                raise PhotoFileError(f"{url}: the download failed ({type(error).__name__})") from error
            except asyncio.CancelledError:
                await self._killed()
                raise
        if not answer:
            await self._killed()
            raise PhotoFileError(f"{url}: the download ended")
        if answer["error"]:
            raise PhotoFileError(answer["error"], final=bool(answer["final"]))
        return part

    async def start(self) -> None:
        """Start the process, if none runs, so that this is not part of the first download.

        Raises:
            PhotoFileError: it does not start.
        """
        async with self._lock:
            await self._started()

    async def close(self) -> None:
        """End the process; a later download starts another one."""
        process = self._process
        if process is None:
            return
        assert process.stdin is not None
        process.stdin.close()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_EXIT_S):
                await process.wait()
        await self._killed()

    async def _started(self) -> asyncio.subprocess.Process:
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-m",
                "panoexec.adapters.files.http_worker",
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is for the parent
            )
            await self._until_it_listens(self._process)
        return self._process

    async def _until_it_listens(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        try:
            async with asyncio.timeout(_START_S):
                line = await process.stdout.readline()
        except TimeoutError as error:
            await self._killed()
            raise PhotoFileError(f"the process that downloads did not start within {_START_S:g} s") from error
        except asyncio.CancelledError:
            await self._killed()
            raise
        if not line:
            await self._killed()
            raise PhotoFileError("the process that downloads ended as it started")

    async def _killed(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
