"""The users of the page: a file with names, roles and salted hashes (scrypt), never a password."""

from __future__ import annotations

import base64
import hashlib
import hmac
import os
import re
import secrets
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, TypeAlias

from panoexec.errors import InputFileError, UsageError
from panoexec.files import write_atomically

Role: TypeAlias = Literal["viewer", "operator"]

SHORTEST: Final = 8
"""Characters of a password."""

_LONGEST: Final = 200
_N, _R, _P = 2**14, 8, 1
"""scrypt: 16 MB and about 50 ms a try (RFC 7914)."""

_NAME = re.compile(r"[^\W_](?:[\w .@-]{0,38}[\w.@-])?")
_HEAD: Final = "# users of panoexec web: name:role:scrypt$n$r$p$salt$hash; written by panoexec web --add-user\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredUser:
    """One line of the file."""

    name: str
    role: Role
    secret: str

    def matches(self, password: str) -> bool:
        """Whether this is the password; takes as long as a hash."""
        _, n, r, p, salt, expected = self.secret.split("$")
        found = _hash(password, base64.b64decode(salt), int(n), int(r), int(p))
        return hmac.compare_digest(found, base64.b64decode(expected))


def new_user(name: str, role: Role, password: str) -> StoredUser:
    """A user with a fresh salt.

    Raises:
        UsageError: name or password cannot be used.
    """
    if not _NAME.fullmatch(name) or not name.isprintable():
        raise UsageError(f"{name!r} is no name for a user: 1 to 40 letters, digits, spaces or . @ - _, a letter first")
    if not SHORTEST <= len(password) <= _LONGEST:
        raise UsageError(f"a password must have {SHORTEST} to {_LONGEST} characters")
    salt = secrets.token_bytes(16)
    coded = "$".join(base64.b64encode(one).decode() for one in (salt, _hash(password, salt, _N, _R, _P)))
    return StoredUser(name=name, role=role, secret=f"scrypt${_N}${_R}${_P}${coded}")


def read_users(path: Path) -> dict[str, StoredUser]:
    """The users by name.

    Raises:
        InputFileError: the file cannot be read, is readable by everybody, or a line makes no sense.
    """
    try:
        mode, text = path.stat().st_mode, path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8"
        raise InputFileError(str(path), [f"cannot be read ({reason}); make it with panoexec web --add-user"]) from error
    if mode & stat.S_IRWXO:
        shown = f"readable by everybody on this computer (mode {stat.S_IMODE(mode):o}); chmod 640"
        raise InputFileError(str(path), [shown])
    users: dict[str, StoredUser] = {}
    problems = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        user = _user_of(line)
        if user is None or user.name in users:
            problems.append(f"line {number}: {'a second line of a user' if user else 'not name:role:scrypt$…'}")
            continue
        users[user.name] = user
    if problems:
        raise InputFileError(str(path), problems)
    return users


def write_users(path: Path, users: dict[str, StoredUser]) -> None:
    """Write the file, whole, readable by its owner and group.

    Raises:
        UsageError: it cannot be written.
    """
    lines = [f"{user.name}:{user.role}:{user.secret}\n" for _, user in sorted(users.items())]
    kept = path.stat() if path.exists() else None
    write_atomically(path, _HEAD + "".join(lines))
    try:
        path.chmod(0o640 if kept is None else stat.S_IMODE(kept.st_mode) & ~stat.S_IRWXO)
        if kept is not None:
            _give(path, kept.st_uid, kept.st_gid)
        else:
            _give(path, -1, path.parent.stat().st_gid)
    except OSError as error:
        raise UsageError(f"{path}: its mode cannot be set ({error.strerror})") from error


def _give(path: Path, owner: int, group: int) -> None:
    if os.name != "nt" and os.geteuid() == 0:
        os.chown(path, owner, group)


def _user_of(line: str) -> StoredUser | None:
    parts = line.strip().rsplit(":", 2)
    if len(parts) != 3 or parts[1] not in ("viewer", "operator") or not _NAME.fullmatch(parts[0]):
        return None
    fields = parts[2].split("$")
    try:
        kind, n, r, p, salt, value = fields
        sound = kind == "scrypt" and 2**10 <= int(n) <= 2**17 and 1 <= int(r) <= 16 and 1 <= int(p) <= 4
        whole = len(base64.b64decode(salt, validate=True)) >= 8 and len(base64.b64decode(value, validate=True)) == 32
    except ValueError:
        return None
    role: Role = "operator" if parts[1] == "operator" else "viewer"
    return StoredUser(name=parts[0], role=role, secret=parts[2]) if sound and whole else None


def _hash(password: str, salt: bytes, n: int, r: int, p: int) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, n=n, r=r, p=p, maxmem=256 * n * r + 2**20, dklen=32)
