"""Who may do what: logins, sessions in cookies, and the hosts and origins from which the page may be used."""

from __future__ import annotations

import asyncio
import hashlib
import ipaddress
import secrets
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

import structlog

from panoexec.errors import InputFileError, PanoexecError
from panoexec.web.users import Role, StoredUser, new_user, read_users

COOKIE: Final = "panoexec_session"
PHOTOS: Final = "panoexec_photos"
"""A second cookie that opens photos and nothing else: a report runs in an origin of its own, from which browsers send
no cookie that is SameSite=Strict."""

SESSION_S: Final = 12 * 3600.0
_MOST_SESSIONS: Final = 1_000
_WINDOW_S: Final = 60.0
_FAILURES: Final = 5
"""Failed logins of one address a minute."""

_FAILURES_OF_NAME: Final = 30
"""Of one name: slows down guessing from many addresses without locking its owner out for long."""

_WAITING: Final = 8
_REMEMBERED: Final = 5_000
_LOCAL: Final = frozenset({"localhost", "127.0.0.1", "::1"})

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class User:
    """Somebody who looks at the page; without a login `name` is ""."""

    name: str
    role: Role


ANYBODY = User(name="", role="operator")
"""Without a login: whoever can reach the address of this computer."""


class LoginRefusedError(PanoexecError):
    """A login that failed.

    Attributes:
        too_many: whether nothing was tried, because too many failed before.
    """

    def __init__(self, text: str, *, too_many: bool = False) -> None:
        super().__init__(text)
        self.too_many = too_many


@dataclass(frozen=True, slots=True)
class _Session:
    name: str
    ends_s: float


class Access:
    """Logins and sessions.

    Attributes:
        needs_login: whether somebody has to log in.
    """

    def __init__(
        self,
        users_file: Path | None,
        *,
        origins: tuple[str, ...] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Describe it.

        Args:
            users_file: who may log in; None: anybody on this computer may use the page.
            origins: of proxies in front of the server.
            clock: monotonic seconds.

        Raises:
            InputFileError: the file makes no sense.
        """
        self.needs_login = users_file is not None
        self._file = users_file
        self._origins = frozenset(origin.lower() for origin in origins)
        self._clock = clock
        self._users: Mapping[str, StoredUser] = {}
        self._stamp: tuple[int, int, int] | None = None
        self._sessions: OrderedDict[str, _Session] = OrderedDict()
        self._photo_keys: OrderedDict[str, str] = OrderedDict()
        self._failures: OrderedDict[str, deque[float]] = OrderedDict()
        self._hashing = asyncio.Semaphore(1)
        self._waiting = 0
        self._decoy = new_user("nobody", "viewer", secrets.token_hex(8)) if users_file is not None else None
        if users_file is not None:
            self._users = read_users(users_file)
            self._stamp = _stamp(users_file)

    # --- who asks

    def user(self, token: str | None) -> User | None:
        """The user of a session; anybody without logins; None for nobody."""
        if not self.needs_login:
            return ANYBODY
        return self._user_of(_digest(token)) if token else None

    def _user_of(self, key: str) -> User | None:
        session = self._sessions.get(key)
        if session is None or session.ends_s < self._clock():
            return None
        stored = self._current_users().get(session.name)
        return None if stored is None else User(name=stored.name, role=stored.role)

    def may_come_from(self, *, host: str, origin: str | None, acts: bool) -> bool:
        """Whether a request may be answered.

        Args:
            host: header `Host`: without logins it must name this computer, or a page of elsewhere could be given the
                address of this one (DNS rebinding).
            origin: header `Origin`.
            acts: whether it opens the socket, logs in, or changes something: then it must come from our own page.
        """
        name, host = _host_name(host), host.lower()
        if not name:
            return False
        if not self.needs_login and name not in _LOCAL and not any(_place(one) == host for one in self._origins):
            return False
        if origin is None:
            return not acts
        return origin.lower() in self._origins or _place(origin) == host

    def photo_token(self, token: str) -> str:
        """For the cookie `PHOTOS`: ends with the session, and tells nothing of its token."""
        return _digest(f"photos {token}")

    def may_see_photos(self, photo_token: str | None) -> User | None:
        """The user of a session, by its photo token; None for nobody."""
        key = self._photo_keys.get(_digest(photo_token)) if photo_token else None
        return None if key is None else self._user_of(key)

    # --- logins

    async def log_in(self, name: str, password: str, address: str) -> str:
        """Check a password and begin a session.

        Args:
            name: of the user.
            password: as typed.
            address: where the request comes from.

        Returns:
            The token for the cookie.

        Raises:
            LoginRefusedError: it failed.
        """
        keys = ((f"address {_network(address)}", _FAILURES), (f"name {name[:80]}", _FAILURES_OF_NAME))
        if any(self._recent(key) >= most for key, most in keys) or self._waiting >= _WAITING:
            raise LoginRefusedError("too many failed logins: try again in a minute", too_many=True)
        # counted before the hash is computed: tries at the same time count, too
        now = self._clock()
        for key, _ in keys:
            self._failures.setdefault(key, deque(maxlen=_FAILURES_OF_NAME)).append(now)
            self._failures.move_to_end(key)
        while len(self._failures) > _REMEMBERED:
            self._failures.popitem(last=False)
        stored = self._current_users().get(name)
        self._waiting += 1
        try:
            async with self._hashing:
                # a name that does not exist takes as long as one that does
                fits = await asyncio.to_thread((stored or self._decoy_user()).matches, password)
        finally:
            self._waiting -= 1
        if stored is None or not fits:
            _log.warning("login failed", user=name[:80], address=address)
            raise LoginRefusedError("name or password is wrong")
        for key, _ in keys:
            self._failures[key].pop()
        token = secrets.token_urlsafe(32)
        self._sessions[_digest(token)] = _Session(stored.name, self._clock() + SESSION_S)
        self._photo_keys[_digest(self.photo_token(token))] = _digest(token)
        while len(self._sessions) > _MOST_SESSIONS:
            self._sessions.popitem(last=False)
        while len(self._photo_keys) > _MOST_SESSIONS:
            self._photo_keys.popitem(last=False)
        _log.info("logged in", user=stored.name, role=stored.role, address=address)
        return token

    def log_out(self, token: str | None) -> None:
        """End a session."""
        if token:
            self._sessions.pop(_digest(token), None)

    def _recent(self, key: str) -> int:
        now = self._clock()
        return sum(1 for moment in self._failures.get(key, ()) if now - moment < _WINDOW_S)

    def _decoy_user(self) -> StoredUser:
        assert self._decoy is not None
        return self._decoy

    def _current_users(self) -> Mapping[str, StoredUser]:
        """The users as the file has them now; a file that makes no sense lets nobody in."""
        assert self._file is not None
        stamp = _stamp(self._file)
        if stamp != self._stamp:
            self._stamp = stamp
            try:
                self._users = read_users(self._file)
            except InputFileError as error:
                self._users = {}
                _log.error("nobody can log in", reason=str(error))
        return self._users


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_mtime_ns, stat.st_size, stat.st_mode


def _digest(token: str) -> str:
    # a session is found by the hash of its token: the time that takes tells nothing about tokens
    return hashlib.sha256(token.encode(errors="replace")).hexdigest()


def _place(origin: str) -> str:
    """Host and port of an origin; "" of `null` and of what is none."""
    try:
        parts = urlsplit(origin.lower())
    except ValueError:
        return ""
    return parts.netloc if parts.scheme in {"http", "https"} else ""


def _host_name(host: str) -> str | None:
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def is_loopback(host: str) -> bool:
    """Whether an address to listen at is of this computer only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _network(address: str) -> str:
    """Who an address belongs to: with IPv6, everybody has 2^64 of them."""
    try:
        known = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    return str(ipaddress.ip_network((known, 64), strict=False)) if known.version == 6 else str(known)
