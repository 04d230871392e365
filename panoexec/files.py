"""Atomic writes: readers see the old or the new file, never a partial one."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Callable
from pathlib import Path

from panoexec.errors import UsageError


def write_atomically(path: Path, content: bytes | str, *, sync: bool = True) -> None:
    """Write a file atomically: a temporary file in the same folder, fsync, rename.

    Args:
        path: the file; its folder must exist.
        content: bytes, or text that is written as UTF-8.
        sync: whether to wait for the disk, so that the file survives a power cut right after.

    Raises:
        UsageError: the file cannot be written; the message names it and the system's reason. No temporary file remains.
    """
    data = content.encode() if isinstance(content, str) else content

    def write(temporary: Path) -> None:
        temporary.write_bytes(data)

    write_atomically_with(path, write, sync=sync)


def write_atomically_with(path: Path, write: Callable[[Path], None], *, sync: bool = True) -> None:
    """Like `write_atomically`, for content that a library writes.

    Args:
        path: the file; its folder must exist.
        write: writes the content to the given path, which has the same suffix as `path`.
        sync: as above.

    Raises:
        UsageError: the file cannot be written. Other exceptions of `write` propagate; no temporary file remains.
    """
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    try:
        # as the umask permits, which a process cannot ask for without setting it
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise _unwritable(path, error) from error
    try:
        write(temporary)
        if sync:
            to_disk(temporary)
        temporary.replace(path)
        if sync:
            to_disk(path.parent)
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def _unwritable(path: Path, error: OSError) -> UsageError:
    reason = error.strerror or type(error).__name__
    return UsageError(f"{path}: cannot be written ({reason}); use a path in an existing, writable folder")


def to_disk(path: Path) -> None:
    """Wait until a file or a folder is on the disk; Windows, which knows it of open files only, is not asked.

    Raises:
        OSError: it cannot be opened, or the disk failed.
    """
    if os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
