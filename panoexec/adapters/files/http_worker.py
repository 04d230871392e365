"""Downloads files by HTTP in a process of its own at low priority, so that it never delays the event loop's work.

Says in its first line that it listens. Then reads one JSON object per line (a job: `url`, `part`, `hosts`, `max_bytes`,
`timeout_s`, `documents`) and writes one per line (its result: `error`, "" for none, and `final`). Exits at the end of
its standard input.

A download that was interrupted leaves its part and, beside it, what identifies the file's content (`ETag`, else
`Last-Modified`); the next attempt continues there if the server still has that content.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import aiohttp

from panoexec.errors import PhotoFileError

_NICENESS: Final = 10
_CONNECT_S: Final = 10.0
_SILENT_S: Final = 20.0
_CHUNK_BYTES: Final = 1 << 18
_GONE: Final = frozenset({401, 403, 405, 410, 451})
_PAGES: Final = ("text/", "application/xhtml", "application/json", "application/xml")


async def download(session: aiohttp.ClientSession, job: Mapping[str, Any]) -> None:
    """Download one file to its part.

    Raises:
        PhotoFileError: it could not be downloaded, or is not to be.
    """
    url, part = str(job["url"]), Path(job["part"])
    check_url(url, job["hosts"])
    try:
        async with asyncio.timeout(float(job["timeout_s"])):
            await _download(session, url, part, int(job["max_bytes"]), documents=bool(job["documents"]))
    except TimeoutError as error:
        raise PhotoFileError(f"{url}: not complete after {job['timeout_s']:g} s") from error
    except aiohttp.ClientError as error:
        raise PhotoFileError(f"{url}: {error or type(error).__name__}") from error
    except OSError as error:
        raise PhotoFileError(f"{url}: {error.strerror or error}") from error


def check_url(url: str, hosts: list[str]) -> None:
    """Refuse a URL of another host.

    Raises:
        PhotoFileError: final.
    """
    try:
        parts = urlsplit(url)
        host, _ = (parts.hostname or "").lower(), parts.port
    except ValueError as error:
        raise PhotoFileError(f"{url}: not a URL", final=True) from error
    if parts.scheme not in {"http", "https"}:
        raise PhotoFileError(f"{url}: not http or https", final=True)
    if host not in hosts:
        raise PhotoFileError(f"{url}: host {host!r} is not in [camera] file_hosts", final=True)


async def _download(session: aiohttp.ClientSession, url: str, part: Path, max_bytes: int, *, documents: bool) -> None:
    mark = part.with_name(f"{part.name}.tag")
    have, tag = _left(part, mark)
    headers = {"Accept-Encoding": "identity"}
    if have:
        headers |= {"Range": f"bytes={have}-", "If-Range": tag}
    async with session.get(url, headers=headers, allow_redirects=False) as answer:
        _check_answer(url, answer, documents=documents)
        start = _start(answer, have)
        size = answer.content_length
        if size is not None and start + size > max_bytes:
            raise PhotoFileError(f"{url}: has {start + size} bytes, at most {max_bytes} are accepted", final=True)
        _note(mark, answer.headers.get("ETag") or answer.headers.get("Last-Modified") or "")
        written = start
        with part.open("r+b" if start else "wb") as file:
            file.seek(start)
            async for chunk in answer.content.iter_chunked(_CHUNK_BYTES):
                written += len(chunk)
                if written > max_bytes:
                    raise PhotoFileError(f"{url}: is larger than {max_bytes} bytes", final=True)
                file.write(chunk)
            file.truncate()
        if size is not None and written != start + size:
            raise PhotoFileError(f"{url}: ended after {written} of {start + size} bytes")
    mark.unlink(missing_ok=True)


def _check_answer(url: str, answer: aiohttp.ClientResponse, *, documents: bool) -> None:
    status = answer.status
    if 300 <= status < 400:
        raise PhotoFileError(
            f"{url}: redirects to {answer.headers.get('Location', '')!r}, which is refused", final=True
        )
    if status not in {200, 206}:
        # not there yet (404), busy (503): cameras write while they are asked
        raise PhotoFileError(f"{url}: HTTP {status} {answer.reason or ''}".rstrip(), final=status in _GONE)
    if answer.content_type.startswith(_PAGES) and not documents:
        raise PhotoFileError(f"{url}: is a web page ({answer.content_type}), not a photo", final=True)


def _left(part: Path, mark: Path) -> tuple[int, str]:
    """Bytes that an earlier attempt left, and what identifies them; (0, "") for nothing that can be continued."""
    try:
        tag, size = mark.read_text(encoding="utf-8"), part.stat().st_size
    except (OSError, ValueError):
        return 0, ""
    return (size, tag) if tag and not tag.startswith("W/") else (0, "")


def _start(answer: aiohttp.ClientResponse, asked: int) -> int:
    """From which byte on the answer is."""
    if answer.status != 206:
        return 0
    told = answer.headers.get("Content-Range", "")
    if not asked or not told.startswith(f"bytes {asked}-"):
        raise PhotoFileError(f"{answer.url}: answers with another part than asked ({told!r})")
    return asked


def _note(mark: Path, tag: str) -> None:
    if tag:
        mark.write_text(tag, encoding="utf-8")
    else:
        mark.unlink(missing_ok=True)


async def _work() -> None:
    os.nice(_NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    patience = aiohttp.ClientTimeout(total=None, sock_connect=_CONNECT_S, sock_read=_SILENT_S)
    async with aiohttp.ClientSession(timeout=patience, trust_env=False, auto_decompress=False) as session:
        print(json.dumps({"listens": True}), flush=True)
        while line := await reader.readline():
            answer = {"error": "", "final": False}
            try:
                await download(session, json.loads(line))
            except PhotoFileError as error:
                answer = {"error": str(error), "final": error.final}
            except Exception as error:  # noqa: BLE001  (an odd answer of a camera must not end the others' downloads)
                answer = {"error": f"{type(error).__name__}: {error}", "final": False}
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError):
        asyncio.run(_work())
