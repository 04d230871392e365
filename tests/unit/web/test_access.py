"""Users, logins, sessions, and from where the page may be used."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from panoexec.errors import InputFileError, UsageError
from panoexec.web.access import Access, LoginRefusedError, User
from panoexec.web.users import new_user, read_users, write_users

PASSWORD = "correct horse"


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def users_file(tmp_path: Path) -> Path:
    path = tmp_path / "users"
    both = (new_user("anna", "operator", PASSWORD), new_user("bert", "viewer", "another one"))
    write_users(path, {user.name: user for user in both})
    return path


def test_the_file_has_hashes_that_only_owner_and_group_read(users_file: Path) -> None:
    assert stat.S_IMODE(users_file.stat().st_mode) == 0o640
    text = users_file.read_text(encoding="utf-8")
    assert PASSWORD not in text
    users = read_users(users_file)
    assert users["anna"].matches(PASSWORD)
    assert not users["anna"].matches("correct horse ")
    again = new_user("anna", "operator", PASSWORD)
    assert again.secret != users["anna"].secret, "salted"


def test_a_file_that_everybody_reads_or_that_makes_no_sense_is_refused(users_file: Path) -> None:
    users_file.chmod(0o644)
    with pytest.raises(InputFileError, match="chmod 640"):
        read_users(users_file)
    users_file.chmod(0o640)
    for line in ("anna", "anna:king:x", "anna:operator:scrypt$16384$8$1$AAAA$AAAA", "a:b:operator:plain"):
        users_file.write_text(f"# comment\n{line}\n", encoding="utf-8")
        with pytest.raises(InputFileError, match="line 2"):
            read_users(users_file)


@pytest.mark.parametrize(
    ("name", "password"), [("a:b", PASSWORD), ("", PASSWORD), ("x\ny", PASSWORD), ("anna", "short")]
)
def test_names_and_passwords_that_cannot_be_used(name: str, password: str) -> None:
    with pytest.raises(UsageError):
        new_user(name, "viewer", password)


async def test_a_session_ends_with_time_logout_and_the_user(users_file: Path) -> None:
    clock = Clock()
    access = Access(users_file, clock=clock)
    assert access.user(None) is None
    assert access.user("guess") is None
    token = await access.log_in("anna", PASSWORD, "10.0.0.1")
    assert access.user(token) == User(name="anna", role="operator")
    clock.now_s += 13 * 3600
    assert access.user(token) is None

    token = await access.log_in("anna", PASSWORD, "10.0.0.1")
    access.log_out(token)
    assert access.user(token) is None

    token = await access.log_in("anna", PASSWORD, "10.0.0.1")
    write_users(users_file, {"anna": new_user("anna", "viewer", PASSWORD)})
    assert access.user(token) == User(name="anna", role="viewer"), "a change of role holds at once"
    write_users(users_file, {})
    assert access.user(token) is None


async def test_failed_logins_are_limited_for_each_address(users_file: Path) -> None:
    clock = Clock()
    access = Access(users_file, clock=clock)
    for name in ("anna", "nobody", "anna", "anna", ""):
        with pytest.raises(LoginRefusedError, match="name or password is wrong"):
            await access.log_in(name, "wrong one", "10.0.0.1")
    with pytest.raises(LoginRefusedError, match="too many") as refused:
        await access.log_in("anna", PASSWORD, "10.0.0.1")
    assert refused.value.too_many
    assert await access.log_in("anna", PASSWORD, "10.0.0.2"), "others can still log in"
    clock.now_s += 61
    assert await access.log_in("anna", PASSWORD, "10.0.0.1")


async def test_one_network_of_ipv6_counts_as_one_address(users_file: Path) -> None:
    access = Access(users_file, clock=Clock())
    for number in range(5):
        with pytest.raises(LoginRefusedError, match="wrong"):
            await access.log_in("anna", "wrong one", f"2001:db8::{number:x}")
    with pytest.raises(LoginRefusedError, match="too many"):
        await access.log_in("anna", PASSWORD, "2001:db8::ffff")


@pytest.mark.parametrize(
    ("host", "origin", "acts", "allowed"),
    [
        ("127.0.0.1:8090", None, False, True),
        ("localhost:8090", None, False, True),
        ("[::1]:8090", "http://[::1]:8090", True, True),
        ("127.0.0.1:8090", "http://127.0.0.1:8090", True, True),
        ("127.0.0.1:8090", None, True, False),
        ("127.0.0.1:8090", "null", True, False),
        ("127.0.0.1:8090", "http://evil.example", True, False),
        ("127.0.0.1:8090", "http://127.0.0.1:9999", True, False),
        ("127.0.0.1:8090", "file://127.0.0.1:8090", True, False),
        ("evil.example:8090", "http://evil.example:8090", True, False),  # its name was given our address
        ("evil.example:8090", None, False, False),
        ("", "http://", True, False),
        ("[", None, False, False),
    ],
)
def test_where_the_page_may_be_used_from_without_logins(
    host: str, origin: str | None, acts: bool, allowed: bool
) -> None:
    assert Access(None).may_come_from(host=host, origin=origin, acts=acts) is allowed


def test_a_proxy_may_have_another_name(users_file: Path) -> None:
    access = Access(users_file, origins=("https://ground.example",))
    assert access.may_come_from(host="127.0.0.1:8090", origin="https://ground.example", acts=True)
    assert access.may_come_from(host="drone.local:8090", origin="http://drone.local:8090", acts=True)
    assert not access.may_come_from(host="drone.local:8090", origin="https://ground.example.evil", acts=True)
    alone = Access(None, origins=("https://ground.example",))
    assert alone.may_come_from(host="ground.example", origin="https://ground.example", acts=True)
