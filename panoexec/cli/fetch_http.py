"""Brings a mission here from the operator's page (`panoexec web`): an archive, continued where it broke off, unpacked.

The archive has each file stored, not compressed, so what it says of sizes can be held to its own size. Only the host of
the URL is asked; redirects are refused. The part of an archive stays in the target folder, with its `ETag`, until it is
whole: a mission that changed meanwhile begins anew.
"""

from __future__ import annotations

import http.client
import json
import os
import re
import shutil
import ssl
import stat
import time
import urllib.parse
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Final

from panoexec.errors import DeviceError, UsageError
from panoexec.files import to_disk, write_atomically_with
from panoexec.store.catalogue import check_copy_goes_no_further
from panoexec.store.directory import MissionDirectory

_TIMEOUT_S: Final = 20.0
_CHUNK: Final = 1 << 18
_TRIES: Final = 6
"""So often in a row a transfer may break off without any progress."""
_PAUSE_S: Final = 1.0
_LIST_BYTES: Final = 16 << 20
_RANGE: Final = re.compile(r"bytes (\d+)-(\d+)/(\d+)")


class TransferError(DeviceError):
    """The server is not there, refuses, or answers what makes no sense."""


@dataclass(frozen=True, slots=True)
class _Answer:
    status: int
    headers: Mapping[str, str]


class Page:
    """The missions behind one operator's page."""

    def __init__(self, url: str, *, ca_file: Path | None = None) -> None:
        """Check the URL; nothing is sent.

        Args:
            url: `http://HOST:PORT` or `https://HOST:PORT`.
            ca_file: what certifies the server; None: the system's.

        Raises:
            UsageError: it is no such URL, or the file cannot be used.
        """
        try:
            parts = urllib.parse.urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError:
            host, port, parts = None, None, urllib.parse.urlsplit("")
        if not host or parts.scheme not in {"http", "https"} or parts.path not in {"", "/"} or parts.query:
            raise UsageError(f"--url {url}: expected http://HOST:PORT or https://HOST:PORT")
        if parts.username or parts.password:
            raise UsageError("--url has a login in it: give --user NAME and --password-file FILE")
        self.origin = f"{parts.scheme}://{parts.netloc}"
        self._host, self._port = host, port
        self._tls: ssl.SSLContext | None = None
        if parts.scheme == "https":
            try:
                self._tls = ssl.create_default_context(cafile=None if ca_file is None else str(ca_file))
            except (OSError, ssl.SSLError) as error:
                raise UsageError(f"--ca-file {ca_file}: {error}") from error
        self._cookie = ""

    # --- requests

    def _connection(self) -> http.client.HTTPConnection:
        if self._tls is not None:
            return http.client.HTTPSConnection(self._host, self._port, timeout=_TIMEOUT_S, context=self._tls)
        return http.client.HTTPConnection(self._host, self._port, timeout=_TIMEOUT_S)

    def _asked(
        self,
        method: str,
        path: str,
        take: Callable[[_Answer, IO[bytes]], None],
        *,
        body: str | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        """Send a request, and hand its answer over.

        Raises:
            TransferError: no answer, a login is needed, or a redirect.
        """
        sent = {"Origin": self.origin, "Accept-Encoding": "identity", **(headers or {})}
        if self._cookie:
            sent["Cookie"] = self._cookie
        connection = self._connection()
        try:
            connection.request(method, path, body=body, headers=sent)
            with connection.getresponse() as answer:
                take(_Answer(answer.status, {name.lower(): value for name, value in answer.getheaders()}), answer)
        except (OSError, http.client.HTTPException) as error:
            text = str(error) or type(error).__name__
            raise TransferError(f"{self.origin}: {text}") from error
        finally:
            connection.close()

    def log_in(self, name: str, password: str) -> None:
        """Begin a session.

        Raises:
            TransferError: refused.
        """
        told: list[_Answer] = []
        body = urllib.parse.urlencode({"name": name, "password": password})
        kind = {"Content-Type": "application/x-www-form-urlencoded"}
        self._asked("POST", "/login", lambda answer, _: told.append(answer), body=body, headers=kind)
        cookie = told[0].headers.get("set-cookie", "").partition(";")[0]
        if told[0].status != 303 or "failed" in told[0].headers.get("location", "") or not cookie:
            wait = "wait" in told[0].headers.get("location", "")
            raise TransferError(
                f"{self.origin}: login refused: " + ("too many failed; wait" if wait else "wrong name or password")
            )
        self._cookie = cookie

    def missions(self) -> list[str]:
        """The ids of its missions.

        Raises:
            TransferError: they cannot be listed.
        """
        out: list[bytes] = []

        def take(answer: _Answer, content: IO[bytes]) -> None:
            self._check(answer, "/api/missions")
            out.append(content.read(_LIST_BYTES))

        self._asked("GET", "/api/missions", take)
        try:
            document = json.loads(out[0])
            return [str(one["mission_id"]) for one in document["missions"]]
        except (ValueError, LookupError, TypeError) as error:
            raise TransferError(f"{self.origin}: not the page of panoexec web") from error

    def _check(self, answer: _Answer, what: str) -> None:
        if answer.status in {200, 206}:
            return
        if answer.status == 401 or (300 <= answer.status < 400 and answer.headers.get("location") == "/login"):
            raise TransferError(f"{self.origin} needs a login: --user NAME, and --password-file FILE or the question")
        if 300 <= answer.status < 400:
            raise TransferError(f"{self.origin}{what}: redirects, which is refused")
        raise TransferError(f"{self.origin}{what}: HTTP {answer.status}")

    # --- one mission

    def fetch(self, mission: str, folder: Path, told: Callable[[str], None]) -> Path:
        """Bring a mission into a folder; what is there of its archive is continued.

        Args:
            mission: its id.
            folder: where the folder of the mission is made.
            told: hears that a transfer broke off.

        Returns:
            The mission's folder.

        Raises:
            TransferError: it does not come, or is no archive of that mission.
            UsageError: it cannot be written.
        """
        part = folder / f".{mission}.zip.part"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._download(mission, part, told)
            _unpack(part, mission, folder)
            part.unlink()
            _tag_of(part).unlink(missing_ok=True)
        except OSError as error:
            raise UsageError(f"{error.filename or folder}: {error.strerror or error}") from error
        return folder / mission

    def _download(self, mission: str, part: Path, told: Callable[[str], None]) -> None:
        tries = 0
        while True:
            before = part.stat().st_size if part.exists() else 0
            try:
                if self._continue(f"/missions/{mission}/download", part):
                    return
                problem = "the transfer broke off"
            except _LastWordError as error:
                raise error.problem from error
            except TransferError as error:
                problem = str(error)
            after = part.stat().st_size if part.exists() else 0
            tries = 0 if after > before else tries + 1
            if tries >= _TRIES:
                raise TransferError(f"{problem}; what is here is continued by the same command")
            told(f"{problem}; goes on at {after / 1e6:.1f} MB")
            time.sleep(_PAUSE_S)

    def _continue(self, path: str, part: Path) -> bool:
        """Ask for what is missing; whether the archive is whole then."""
        tag = _tag_of(part)
        known = tag.read_text(encoding="utf-8") if tag.exists() and part.exists() else ""
        have = part.stat().st_size if known else 0
        whole: list[bool] = []

        def take(answer: _Answer, content: IO[bytes]) -> None:
            if answer.status == 416:  # the part is longer than the archive: it is of another one
                tag.unlink(missing_ok=True)
                part.unlink(missing_ok=True)
                return
            if answer.status == 404:
                raise UsageError(f"{self.origin}: there is no mission {PurePosixPath(path).parent.name}")
            try:
                self._check(answer, path)
                start, size = _extent(answer, have)
            except TransferError as error:
                if answer.status in {502, 503, 504}:
                    raise
                raise _LastWordError(error) from error
            _room(part, size - start)
            with part.open("r+b" if start else "wb") as file:
                if not start:
                    tag.write_text(answer.headers.get("etag", ""), encoding="utf-8")
                file.seek(start)
                at = start
                while at < size and (chunk := content.read(min(_CHUNK, size - at))):
                    file.write(chunk)
                    at += len(chunk)
            whole.append(at == size)

        # with its last byte an archive that is whole already is asked for again, and nothing is 416
        headers = {"Range": f"bytes={max(0, have - 1)}-", "If-Range": known} if have and known else {}
        self._asked("GET", path, take, headers=headers)
        return bool(whole and whole[0])


class _LastWordError(Exception):
    """An answer that no repetition changes."""

    def __init__(self, problem: TransferError) -> None:
        super().__init__(str(problem))
        self.problem = problem


def _tag_of(part: Path) -> Path:
    return part.with_name(f"{part.name}.etag")


def _extent(answer: _Answer, have: int) -> tuple[int, int]:
    """From which byte on the answer is, and the size of the archive.

    Raises:
        TransferError: it does not tell.
    """
    if answer.headers.get("content-type", "").partition(";")[0] != "application/zip":
        raise TransferError("the answer is no archive: is this panoexec web?")
    found = _RANGE.fullmatch(answer.headers.get("content-range", ""))
    if answer.status == 206 and found is not None and int(found[1]) <= have and int(found[2]) + 1 == int(found[3]):
        return int(found[1]), int(found[3])
    length = answer.headers.get("content-length", "")
    if answer.status == 200 and length.isdecimal():
        return 0, int(length)
    raise TransferError("the answer does not tell its size")


def _room(part: Path, missing: int) -> None:
    free = shutil.disk_usage(part.parent).free
    if free < missing:
        raise _LastWordError(
            TransferError(f"{part.parent}: {missing / 1e6:.0f} MB are to come, {free / 1e6:.0f} MB are free")
        )


def _unpack(part: Path, mission: str, folder: Path) -> None:
    """Unpack an archive; each file appears whole, and those that are not in it stay.

    Raises:
        TransferError: it is no archive of that mission. It is removed, so that the next one begins anew.
        UsageError: the mission that is here already has more than the archive.
    """
    try:
        with zipfile.ZipFile(part) as archive:
            entries = archive.infolist()
            _check_entries(entries, mission, part.stat().st_size)
            _room(part, sum(one.file_size for one in entries))
            _check_copy(archive, part, folder / mission)
            for one in entries:
                _write(archive, one, folder / one.filename)
    # RuntimeError: encrypted; ValueError: names that are not text, impossible offsets
    except (zipfile.BadZipFile, RuntimeError, ValueError, EOFError, TransferError) as error:
        _tag_of(part).unlink(missing_ok=True)
        part.unlink(missing_ok=True)
        if isinstance(error, TransferError):
            raise
        raise TransferError(f"{mission}: the archive is damaged ({error}); fetch it again") from error


def _check_copy(archive: zipfile.ZipFile, part: Path, copy: Path) -> None:
    """Raise if the copy that is here already has more than the archive."""
    name = f"{copy.name}/{MissionDirectory(copy).journal.name}"
    if not MissionDirectory(copy).journal.exists() or name not in archive.namelist():
        return
    there = part.with_suffix(".journal")
    try:
        _write(archive, archive.getinfo(name), there)
        check_copy_goes_no_further(MissionDirectory(copy).journal, there)
    finally:
        there.unlink(missing_ok=True)


def _check_entries(entries: Sequence[zipfile.ZipInfo], mission: str, size: int) -> None:
    for one in entries:
        _check_entry(one, mission)
    if sum(one.file_size for one in entries) > size:
        raise TransferError(f"{mission}: the archive says that it holds more than it has")


def _check_entry(one: zipfile.ZipInfo, mission: str) -> None:
    path = PurePosixPath(one.filename)
    inside = len(path.parts) > 1 and path.parts[0] == mission and not path.is_absolute()
    odd = any(part in {"..", "."} or part.startswith(".") for part in path.parts) or "\\" in one.filename
    kind = stat.S_IFMT(one.external_attr >> 16)
    if not inside or odd or not one.filename.isprintable() or kind not in {0, stat.S_IFREG}:
        raise TransferError(f"{mission}: the archive has {one.filename!r}, which is no file of a mission")
    if one.compress_type != zipfile.ZIP_STORED:
        raise TransferError(f"{mission}: {one.filename} is compressed, which panoexec web does not do")


def _write(archive: zipfile.ZipFile, one: zipfile.ZipInfo, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)

    def write(temporary: Path) -> None:
        with archive.open(one) as read, temporary.open("wb") as out:
            shutil.copyfileobj(read, out, _CHUNK)

    write_atomically_with(path, write)
    to_disk(path.parent)


def password_of(file: Path) -> str:
    """The first line of a file.

    Raises:
        UsageError: it cannot be read, or everybody can.
    """
    try:
        mode, text = file.stat().st_mode, file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"--password-file {file}: cannot be read") from error
    if os.name == "posix" and mode & stat.S_IRWXO:
        raise UsageError(f"--password-file {file}: everybody on this computer may read it: chmod 600 {file}")
    return text.partition("\n")[0].rstrip("\r")
