"""The missions of this computer: listed, shown, downloaded, deleted, stitched. URLs have ids, never paths."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shutil
import stat
import sys
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from pathlib import Path
from typing import Any, Final

import structlog
from aiohttp import web

from panoexec.web.audience import Browser, Browsers
from panoexec.web.headers import REPORT_POLICY, secured
from panoexec.web.mission_files import photo_file, preview_file, stitched_file
from panoexec.web.pages import USER
from panoexec.web.protocol import encode, is_mission
from panoexec.web.values import table, text
from panoexec.web.zip_stream import FolderChangedError, zip_stream

_LIST_S: Final = 120.0
_LIST_EVERY_S: Final = 3.0
"""A mission that flies changes all the time."""

_DELETE_S: Final = 120.0
_DOWNLOADS: Final = 4
_CHECKSUMS: Final = 20_000
_KINDS: Final = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png", ".tif": "image/tiff"}

_log = structlog.get_logger(__name__)


class Library:
    """Answers requests about missions."""

    def __init__(self, storage: Path | None, *, browsers: Browsers, spawn: Callable[[Any], object]) -> None:
        """Describe it.

        Args:
            storage: where missions are; None: there are none on this computer.
            browsers: hear of progress, and of changes of the list.
            spawn: starts a task that ends with the server.
        """
        self._storage = storage
        self._browsers = browsers
        self._spawn = spawn
        self._listing = asyncio.Lock()
        self._listed: tuple[object, list[dict[str, Any]]] | None = None
        self._listed_s = 0.0
        self._stitching = ""
        self._downloads = 0
        self._checksums: dict[tuple[str, int, int], int] = {}

    @property
    def has_storage(self) -> bool:
        """Whether missions are stored on this computer."""
        return self._storage is not None

    @property
    def cannot_stitch(self) -> str:
        """Why nothing can be stitched here; "" if it can."""
        if self._storage is None:
            return "no missions are stored on this computer"
        if shutil.which("nona") is None:
            return "Hugin's tools are not installed on this computer"
        if not os.access(self._storage / "missions", os.W_OK):
            return "this server may not write missions"
        return ""

    def add_routes(self, app: web.Application) -> None:
        """Add what is answered here."""
        app.router.add_get("/api/missions", self._list)
        app.router.add_delete("/missions/{mission}", self._delete)
        app.router.add_get("/missions/{mission}/report", self._report)
        app.router.add_get("/missions/{mission}/images/{name:.+}", self._image)
        app.router.add_get("/missions/{mission}/download", self._download)
        app.router.add_get("/missions/{mission}/panorama", self._panorama)
        app.router.add_get("/missions/{mission}/preview", self._preview)

    # --- the list

    async def _list(self, request: web.Request) -> web.StreamResponse:
        del request
        missions = [self._shown(one) for one in reversed(await self._entries())]
        return web.json_response({"storage": self.has_storage, "missions": missions})

    def _shown(self, entry: dict[str, Any]) -> dict[str, Any]:
        mission_id = entry["mission_id"]
        out = {name: value for name, value in entry.items() if name != "finished"}
        for name in ("report", "panorama", "preview"):
            out[name] = f"/missions/{mission_id}/{name}" if entry[name] else None
        out["download"] = f"/missions/{mission_id}/download"
        out["deletable"] = "" if entry["finished"] else f"only finished missions can be deleted: {entry['state']}"
        out["stitch"] = self.cannot_stitch or ("" if entry["photos"] else "no photos have reached this computer")
        if self._stitching:
            out["stitch"] = "this mission is being stitched" if self._stitching == mission_id else "another is stitched"
        return out

    async def _entries(self) -> list[dict[str, Any]]:
        """What the list has, oldest first; made anew when a mission has changed."""
        if self._storage is None:
            return []
        async with self._listing:
            stamp, now = await asyncio.to_thread(_stamp, self._storage), time.monotonic()
            if self._listed is None or (self._listed[0] != stamp and now - self._listed_s > _LIST_EVERY_S):
                code, out, told = await self._run("list", timeout_s=_LIST_S)
                if code:
                    _log.error("missions cannot be listed", reason=told)
                    raise web.HTTPInternalServerError
                self._listed, self._listed_s = (stamp, json.loads(out)), time.monotonic()
            return self._listed[1]

    async def _folder(self, request: web.Request) -> Path:
        """The folder of the mission that a request names.

        Raises:
            web.HTTPNotFound: there is none.
        """
        mission_id = request.match_info["mission"]
        if self._storage is not None and is_mission(mission_id):
            folder = self._storage / "missions" / mission_id
            if await asyncio.to_thread(_is_folder, folder):
                return folder
        raise web.HTTPNotFound

    async def _run(self, command: str, *more: str, timeout_s: float) -> tuple[int, bytes, str]:
        """Run the process that works on missions; its exit code, output and error."""
        process = await self._started(command, *more)
        try:
            async with asyncio.timeout(timeout_s):
                out, told = await process.communicate()
        finally:
            await ended(process)
        return process.returncode or 0, out, text(told.decode(errors="replace").strip())

    async def _started(self, command: str, *more: str) -> asyncio.subprocess.Process:
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "panoexec.web.library_process", command, str(self._storage), *more),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )

    # --- one mission

    async def _report(self, request: web.Request) -> web.StreamResponse:
        folder = await self._folder(request)
        # its scripts run in an origin of their own: a hostile report can neither command nor read this page
        headers = {"Content-Security-Policy": REPORT_POLICY, "X-Frame-Options": "SAMEORIGIN"}
        return _file(folder / "report.html", "text/html", headers)

    async def _image(self, request: web.Request) -> web.StreamResponse:
        folder = await self._folder(request)
        return _file(await asyncio.to_thread(photo_file, folder, request.match_info["name"]))

    async def _panorama(self, request: web.Request) -> web.StreamResponse:
        folder = await self._folder(request)
        path = await asyncio.to_thread(stitched_file, folder)
        name = "" if path is None else f"{folder.name}-{path.name}"
        return _file(path, headers={"Content-Disposition": f'attachment; filename="{name}"'})

    async def _preview(self, request: web.Request) -> web.StreamResponse:
        folder = await self._folder(request)
        return _file(await asyncio.to_thread(preview_file, folder), headers={"Cache-Control": "private, max-age=60"})

    async def _download(self, request: web.Request) -> web.StreamResponse:
        folder = await self._folder(request)
        if self._downloads >= _DOWNLOADS and request.method != "HEAD":
            raise web.HTTPServiceUnavailable(headers={"Retry-After": "30"})
        if len(self._checksums) > _CHECKSUMS:
            self._checksums.clear()
        archive = await asyncio.to_thread(zip_stream, folder, name=folder.name, checksums=self._checksums)
        start, stop, status = _range(request, archive.size, archive.etag)
        response = web.StreamResponse(status=status)
        response.content_type = "application/zip"
        response.content_length = stop - start
        response.headers["ETag"] = archive.etag
        response.headers["Accept-Ranges"] = "bytes"
        response.headers["Content-Disposition"] = f'attachment; filename="{folder.name}.zip"'
        if status == 206:
            response.headers["Content-Range"] = f"bytes {start}-{stop - 1}/{archive.size}"
        await secured(response).prepare(request)
        if request.method == "HEAD":
            return response
        self._downloads += 1
        try:
            await _send(response, archive.read(start, stop))
        except FolderChangedError as error:
            _log.warning("download broken off", mission=folder.name, reason=str(error))
            if request.transport is not None:
                request.transport.abort()
        finally:
            self._downloads -= 1
        return response

    async def _delete(self, request: web.Request) -> web.StreamResponse:
        user = request[USER]
        if user.role != "operator":
            raise web.HTTPForbidden
        mission_id = (await self._folder(request)).name
        if request.headers.get("X-Confirm") != mission_id:
            return _problem(428, "to delete a mission its id has to be confirmed")
        if self._stitching == mission_id:
            return _problem(409, "this mission is being stitched")
        code, _, told = await self._run("delete", mission_id, timeout_s=_DELETE_S)
        self._listed = None
        if code:
            return _problem(409, told or "cannot be deleted")
        _log.info("mission deleted", mission=mission_id, user=user.name)
        self._browsers.tell_all(encode("library"))
        return web.Response(status=204)

    # --- stitching

    def stitch(self, browser: Browser, mission_id: str) -> None:
        """Begin to stitch a mission for a browser, one at a time."""
        refusal = self.cannot_stitch
        if browser.user.role != "operator":
            refusal = "a viewer may look, but not stitch"
        elif self._stitching:
            refusal = "another mission is being stitched"
        if refusal:
            browser.put(encode("problem", text=refusal))
            return
        self._stitching = mission_id
        self._spawn(self._stitch(mission_id, browser.user.name or browser.name))

    async def _stitch(self, mission_id: str, who: str) -> None:
        def tell(stage: str, fraction: float | None, told: str) -> None:
            message = encode("stitch", mission_id=mission_id, stage=stage, fraction=fraction, text=text(told), who=who)
            self._browsers.tell_all(message)

        tell("running", 0.0, "")
        _log.info("stitching", mission=mission_id, user=who)
        process = await self._started("stitch", mission_id)
        try:
            assert process.stdout is not None
            assert process.stderr is not None
            errors = asyncio.create_task(process.stderr.read(), name="stitching errors")
            async for line in process.stdout:
                step = table(_line(line))
                if not step.get("done"):
                    tell("running", step.get("fraction"), f"{step.get('step', '')} {step.get('text', '')}".strip())
            told = (await errors).decode(errors="replace").strip()
            await process.wait()
        finally:
            await ended(process)
            self._stitching = ""
            self._listed = None
        last = told.splitlines()[-1] if told else "stitching failed"
        tell(
            "failed" if process.returncode else "done",
            None if process.returncode else 1.0,
            last if process.returncode else "",
        )
        self._browsers.tell_all(encode("library"))


async def ended(process: asyncio.subprocess.Process) -> None:
    """End a process that is still there."""
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


def _line(line: bytes) -> object:
    try:
        return json.loads(line)
    except ValueError:
        return None


def _stamp(storage: Path) -> object:
    """Changes when a mission comes, goes, or is written to."""
    out = []
    try:
        folders = sorted((storage / "missions").iterdir())
    except OSError:
        return None
    for folder in folders:
        for one in (".", "manifest.json", "journal.sqlite", "report.html", "images", "stitch", "thumbnails"):
            with contextlib.suppress(OSError):
                out.append((folder.name, one, (folder / one).stat().st_mtime_ns))
    return tuple(out)


def _is_folder(path: Path) -> bool:
    try:
        return stat.S_ISDIR(path.lstat().st_mode)
    except OSError:
        return False


def _file(path: Path | None, kind: str = "", headers: dict[str, str] | None = None) -> web.StreamResponse:
    try:
        mode = 0 if path is None else path.lstat().st_mode
    except OSError as error:
        raise web.HTTPNotFound from error
    if path is None or not stat.S_ISREG(mode):  # a link could lead anywhere
        raise web.HTTPNotFound
    response = web.FileResponse(path, headers=headers)
    response.content_type = kind or _KINDS.get(path.suffix.lower(), "application/octet-stream")
    return response


def _range(request: web.Request, size: int, etag: str) -> tuple[int, int, int]:
    """First byte, byte after the last one, and status; the whole if the archive is not the one that was begun.

    Raises:
        web.HTTPRequestRangeNotSatisfiable: beyond its end.
    """
    if request.headers.get("If-Range", etag) != etag:
        return 0, size, 200
    try:
        asked = request.http_range
    except ValueError:
        return 0, size, 200  # a form that is not known is ignored (RFC 9110)
    if asked.start is None and asked.stop is None:
        return 0, size, 200
    start = asked.start or 0
    start = max(0, size + start) if start < 0 else start
    stop = size if asked.stop is None else min(asked.stop, size)
    if start >= stop:
        raise web.HTTPRequestRangeNotSatisfiable(headers={"Content-Range": f"bytes */{size}"})
    return start, stop, 206


async def _send(response: web.StreamResponse, chunks: AsyncGenerator[bytes]) -> None:
    with contextlib.suppress(ConnectionError):
        async with aclosing(chunks):
            async for chunk in chunks:
                await response.write(chunk)
        await response.write_eof()


def _problem(status: int, told: str) -> web.Response:
    return web.json_response({"error": told}, status=status)
