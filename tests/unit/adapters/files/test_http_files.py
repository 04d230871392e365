"""Photos by HTTP from cameras that behave, and from those that do not."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from panoexec.adapters.files.http_files import HttpFiles
from panoexec.errors import PhotoFileError
from panoexec.sim.photos.file_server import serving_photos
from tests.waiting import eventually

Answer = Callable[[asyncio.StreamReader, asyncio.StreamWriter, str], Any]
DATA = random.Random(2).randbytes(400_000)


@contextlib.asynccontextmanager
async def _server(answer: Answer) -> AsyncIterator[str]:
    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
            asked = (await reader.readuntil(b"\r\n\r\n")).decode()
            await answer(reader, writer, asked)
        writer.close()

    server = await asyncio.start_server(handle, "127.0.0.1", 0)
    try:
        yield f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/DCIM/1.jpg"
    finally:
        server.close()


@contextlib.asynccontextmanager
async def _files(**options: Any) -> AsyncIterator[HttpFiles]:
    files = HttpFiles(lambda: ["127.0.0.1"], **options)
    try:
        yield files
    finally:
        await files.close()


def _head(status: str, **headers: object) -> bytes:
    lines = [f"HTTP/1.1 {status}", "Connection: close", *(f"{k.replace('_', '-')}: {v}" for k, v in headers.items())]
    return "\r\n".join([*lines, "", ""]).encode()


async def test_an_interrupted_download_goes_on_where_it_ended(tmp_path: Path) -> None:
    part, asked, tags = tmp_path / "part", list[str](), ['"a"', '"a"', '"b"', '"b"']

    async def answer(_reader: Any, writer: asyncio.StreamWriter, request: str) -> None:
        asked.append(request)
        tag = tags[len(asked) - 1]
        start = 0
        if f"If-Range: {tag}" in request:
            start = int(request.split("Range: bytes=")[1].split("-", maxsplit=1)[0])
        status = "206 Partial Content" if start else "200 OK"
        span = {"Content_Range": f"bytes {start}-{len(DATA) - 1}/{len(DATA)}"} if start else {}
        writer.write(_head(status, ETag=tag, Content_Length=len(DATA) - start, **span))
        writer.write(DATA[start : start + 150_000] if len(asked) < 4 else DATA[start:])
        await writer.drain()

    async with _server(answer) as url, _files() as files:
        for have in (150_000, 300_000, 150_000):  # the third finds another content: begun anew
            with pytest.raises(PhotoFileError, match=r"127\.0\.0\.1.*") as error:
                await files.fetch(url, part)
            assert not error.value.final
            assert part.stat().st_size == have
            assert DATA.startswith(part.read_bytes())
        assert await files.fetch(url, part) == part
    assert part.read_bytes() == DATA
    assert not part.with_name("part.tag").exists()
    assert "Range: bytes=150000-" in asked[1]


ODD = [
    (_head("302 Found", Location="http://example.org/1.jpg"), b"", "redirects to 'http://example.org/1.jpg'", True),
    (_head("200 OK", Content_Type="text/html; charset=utf-8"), b"<html>", "is a web page", True),
    (_head("404 Not Found"), b"", "HTTP 404 Not Found", False),
    (_head("503 Service Unavailable"), b"", "HTTP 503", False),
    (_head("403 Forbidden"), b"", "HTTP 403", True),
    (_head("200 OK", Content_Length=300_000_000), b"", "has 300000000 bytes, at most 1000000", True),
    (_head("200 OK"), b"x" * 1_000_001, "is larger than 1000000 bytes", True),
    (_head("200 OK", Content_Length=90_000), b"x" * 80_000, "127.0.0.1", False),
    (_head("206 Partial Content", Content_Range="bytes 5-9/10"), b"x", "another part than asked", False),
    (b"SSH-2.0-camera\r\n", b"", "127.0.0.1", False),
]


async def test_odd_answers_and_strangers_are_named(tmp_path: Path) -> None:
    found = [ODD[0]]

    async def answer(_reader: Any, writer: asyncio.StreamWriter, _request: str) -> None:
        head, body, _, _ = found[0]
        writer.write(head + body)
        await writer.drain()

    async with _server(answer) as url, _files(max_bytes=1_000_000) as files:
        for one in ODD:
            found[0] = one
            with pytest.raises(PhotoFileError) as error:
                await files.fetch(url, tmp_path / "part")
            assert one[2] in str(error.value)
            assert url in str(error.value)
            assert error.value.final is one[3], one
        for stranger in (
            "http://stranger/1.jpg",
            "http://127.0.0.1@stranger/1.jpg",
            "http://[::1/",
            "http://127.0.0.1:x/",
        ):
            with pytest.raises(PhotoFileError) as error:
                await files.fetch(stranger, tmp_path / "part")
            assert error.value.final


async def test_an_answer_that_never_ends_does(tmp_path: Path) -> None:
    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, _request: str) -> None:
        writer.write(_head("200 OK"))
        while True:
            writer.write(b"x")
            await writer.drain()
            await asyncio.sleep(0.02)

    async with _server(answer) as url, _files(timeout_s=0.5) as files:
        with pytest.raises(PhotoFileError, match=r"not complete after 0\.5 s"):
            await files.fetch(url, tmp_path / "part")


async def test_the_time_of_a_download_begins_when_its_process_listens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = tmp_path / "slow"
    slow.mkdir()
    (slow / "sitecustomize.py").write_text("import time; time.sleep(3.5)")
    monkeypatch.setenv("PYTHONPATH", f"{slow}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.setattr("panoexec.adapters.files.http_files._GRACE_S", 1.0)
    (tmp_path / "1.jpg").write_bytes(DATA)
    with serving_photos(tmp_path) as base:
        async with _files(timeout_s=2.0) as files:
            await files.fetch(f"{base}/1.jpg", tmp_path / "part")
    assert (tmp_path / "part").read_bytes() == DATA


async def test_a_process_that_does_not_start_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sitecustomize.py").write_text("import os; os._exit(3)")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    async with _files() as files:
        with pytest.raises(PhotoFileError, match="ended as it started"):
            await files.fetch("http://127.0.0.1:9/1.jpg", tmp_path / "part")


async def test_a_cancelled_download_ends_its_process_and_the_next_one_starts_another(tmp_path: Path) -> None:
    (tmp_path / "1.jpg").write_bytes(DATA)
    with serving_photos(tmp_path, kb_s=100) as base:
        async with _files() as files:
            fetching = asyncio.create_task(files.fetch(f"{base}/1.jpg", tmp_path / "part"))
            await eventually((tmp_path / "part").exists)
            fetching.cancel()
            with pytest.raises(asyncio.CancelledError):
                await fetching
    with serving_photos(tmp_path) as base:
        async with _files() as files:
            await files.fetch(f"{base}/1.jpg", tmp_path / "part")
    assert (tmp_path / "part").read_bytes() == DATA
