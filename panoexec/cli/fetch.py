"""Bring a mission here: by rsync over ssh, from the operator's page, or from a folder; without MISSION the newest one.

By rsync and from a folder, files that are here already are not copied again. An interrupted transfer goes on, by the
operator's page (`panoexec web`) too. A copy that has more than the mission there, because a card was imported into it
for example, is left as it is (exit code 2). Every photo that the manifest gives a SHA-256 is verified afterwards. On
the drone the user of the ssh connection must be a member of the group panoexec (`adduser USER panoexec`).

Exit code 1: photos are missing or differ from the manifest. 2: no such mission or storage. 3: rsync is missing or
fails, or the page does not answer.

Examples:
  panoexec fetch --from pi@drone.local
  panoexec fetch 20260921T141320.000Z --from pi@drone.local:/srv/panoexec --to flown
  panoexec fetch --from /media/disk/panoexec
  panoexec fetch --url https://drone.local:8090 --user ANNA
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from panoexec.cli.fetch_http import Page, password_of
from panoexec.cli.output import counted, note, print_json
from panoexec.cli.streams import ask_password
from panoexec.errors import DeviceError, PanoexecError, UsageError
from panoexec.files import write_atomically_with
from panoexec.inputs.service_sections import StorageSection
from panoexec.store.catalogue import check_copy_goes_no_further
from panoexec.store.directory import MissionDirectory
from panoexec.store.manifest import read_manifest
from panoexec.store.photo_store import hash_file

_ID = re.compile(r"\d{8}T\d{6}\.\d{3}Z")
_HOST = re.compile(r"(?:[A-Za-z0-9][A-Za-z0-9._-]*@)?(?:[A-Za-z0-9][A-Za-z0-9.-]*|\[[0-9A-Fa-f:]+\])")
_SHOWN = 8


class _TransferError(DeviceError):
    """rsync is missing or failed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("mission", nargs="?", metavar="MISSION", help="mission id (default: the newest one)")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument(
        "--from", dest="source", metavar="SOURCE", help="[USER@]HOST, [USER@]HOST:STORAGE or a storage folder"
    )
    where.add_argument("--url", metavar="URL", help="the operator's page: http://HOST:PORT or https://HOST:PORT")
    parser.add_argument("--user", metavar="NAME", help="with --url: log in as this user of the page")
    parser.add_argument("--password-file", type=Path, metavar="FILE", help="with --user: instead of being asked")
    parser.add_argument("--ca-file", type=Path, metavar="FILE", help="with --url: what certifies an https server")
    parser.add_argument("--to", type=Path, default=Path(), metavar="DIR", help="where the mission is put (.)")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON document on stdout")


def run(args: argparse.Namespace) -> int:
    """Copy and verify."""
    if args.mission is not None and not _ID.fullmatch(args.mission):
        raise UsageError(f"{args.mission}: not a mission id; expected one like 20260921T141320.000Z")
    if args.url is None and (args.user or args.password_file or args.ca_file):
        raise UsageError("--user, --password-file and --ca-file are for --url")
    target = _from_page(args) if args.url is not None else _from_storage(args)
    problems, verified, without_hash = _problems(MissionDirectory(target))
    if args.json:
        print_json({"mission": str(target), "problems": problems})
    else:
        print(target)
    note(_told(verified, without_hash))
    for problem in problems[:_SHOWN]:
        note(problem)
    if len(problems) > _SHOWN:
        note(f"… and {len(problems) - _SHOWN} more")
    return 1 if problems else 0


def _from_page(args: argparse.Namespace) -> Path:
    """Fetch by HTTP; returns the mission's folder."""
    page, to = Page(args.url, ca_file=args.ca_file), Path(args.to)
    if args.user:
        if args.password_file is None and not sys.stdin.isatty():
            raise UsageError("--user needs --password-file where nobody can be asked")
        page.log_in(args.user, password_of(args.password_file) if args.password_file else ask_password("Password: "))
    name = args.mission or _newest(page.missions(), f"--url {args.url}")
    return page.fetch(name, to, note)


def _from_storage(args: argparse.Namespace) -> Path:
    """Copy from a folder, or by rsync; returns the mission's folder."""
    folder = Path(args.source) / "missions" if Path(args.source).is_dir() else None
    remote = "" if folder is not None else _missions_of(args.source)
    name = args.mission or _newest(_names(folder, remote), f"--from {args.source}")
    target = Path(args.to) / name
    _check_copy(f"{remote}/{name}", folder and folder / name, MissionDirectory(target).journal)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{target}: cannot be created ({error.strerror})") from error
    if folder is not None:
        _copy(folder / name, target)
    else:
        # hidden: parts of photos and temporary files, which are being written there
        _rsync("--archive", "--partial", "--exclude=.*", f"{remote}/{name}/", f"{target}/")
    return target


def _check_copy(remote: str, folder: Path | None, copy: Path) -> None:
    """Raise if the copy that is here already has more than the mission there."""
    if not copy.exists():
        return
    if folder is not None:
        check_copy_goes_no_further(copy, folder / copy.name)
        return
    with tempfile.TemporaryDirectory(prefix="panoexec-") as place:
        _rsync("--archive", f"{remote}/{copy.name}", f"{place}/")
        check_copy_goes_no_further(copy, Path(place) / copy.name)


def _missions_of(source: str) -> str:
    """The folder `missions` of a host, as rsync names it."""
    if "/" in source.partition(":")[0]:
        raise UsageError(f"--from {source}: no such folder")
    host, _, storage = source.rpartition(":") if re.search(r":[/~.]", source) else (source, "", "")
    if not _HOST.fullmatch(host):
        raise UsageError(f"--from {source}: expected [USER@]HOST, [USER@]HOST:STORAGE or a folder")
    return f"{host}:{storage or StorageSection().path}/missions"


def _names(folder: Path | None, remote: str) -> list[str]:
    """What is in the folder `missions`."""
    if folder is not None:
        return [path.name for path in folder.iterdir()] if folder.is_dir() else []
    return [line.split()[-1] for line in _rsync("--list-only", f"{remote}/").splitlines() if line.startswith("d")]


def _newest(names: list[str], source: str) -> str:
    found = sorted(name for name in names if _ID.fullmatch(name))
    if not found:
        raise UsageError(f"{source}: there is no mission")
    return found[-1]


def _copy(source: Path, target: Path) -> None:
    """Copy what is not there yet; each file appears whole."""
    if not source.is_dir():
        raise UsageError(f"{source}: there is no such mission")
    for path in sorted(source.rglob("*")):
        inner = path.relative_to(source)
        if not path.is_file() or any(part.startswith(".") for part in inner.parts):
            continue
        there = target / inner
        state = path.stat()
        if there.is_file() and (there.stat().st_size, there.stat().st_mtime) == (state.st_size, state.st_mtime):
            continue
        there.parent.mkdir(parents=True, exist_ok=True)
        write_atomically_with(there, partial(shutil.copyfile, path))
        os.utime(there, ns=(state.st_atime_ns, state.st_mtime_ns))


def _rsync(*arguments: str) -> str:
    if shutil.which("rsync") is None:
        raise _TransferError("rsync is not installed: apt-get install rsync")
    done = subprocess.run(["rsync", *arguments], capture_output=True, text=True, check=False)  # noqa: S603, S607
    if done.returncode:
        # ssh tells of host keys that it learns before anything goes wrong
        lines = [line for line in done.stderr.splitlines() if line.strip() and not line.startswith("Warning: ")]
        why = lines[0] if lines else f"exit code {done.returncode}"
        hint = " (there, as root: adduser USER panoexec)" if "Permission denied (13)" in why else ""
        raise _TransferError(f"rsync failed: {why}{hint}")
    return done.stdout


def _told(verified: int, without_hash: int) -> str:
    """What the hashes of the manifest say about the photos, and of how many they say nothing."""
    if verified or not without_hash:
        words = f"photos verified by the hashes of the manifest: {verified}"
    else:
        words = "no photo was verified"
    if without_hash:
        words += f"; {counted(without_hash, 'photo')} came without a hash in the manifest, as those of a dry-run do"
    return words


def _problems(directory: MissionDirectory) -> tuple[list[str], int, int]:
    """Photos that are missing or are not those of the manifest, a line each; how many are; how many have no hash there.

    The last are photos that are here; those on the camera's card do not count. Of a bracket every photo counts.
    """
    try:
        manifest = read_manifest(directory.manifest)
    except PanoexecError as error:
        return [str(error)], 0, 0
    out, verified, without_hash = [], 0, 0
    for shot in manifest["shots"]:
        number = shot.get("accepted_attempt")
        if number is None:
            continue
        attempt: dict[str, Any] = next((one for one in shot.get("attempts", ()) if one["number"] == number), {})
        photos = {(one.get("file"), one.get("sha256")): None for one in (shot, *attempt.get("photos", ()))}
        with_hash = {file for file, digest in photos if digest}
        for file, digest in photos:
            if not file or (not digest and file in with_hash):
                continue
            try:
                found = hash_file(directory.path / file)[1]
            except OSError:
                if digest:
                    out.append(f"shot {shot['index']}: {file} is missing")
                continue  # without a hash it was never stored: it is on the camera's card
            without_hash += not digest
            verified += found == digest
            if digest and found != digest:
                out.append(f"shot {shot['index']}: {file} is not the photo of the manifest")
    return out, verified, without_hash
