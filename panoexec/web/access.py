"""Who may do what: users with salted hashes, sessions in cookies, and the origins from which a socket may be opened."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Role: TypeAlias = Literal["viewer", "operator"]


@dataclass(frozen=True, slots=True, kw_only=True)
class User:
    """Somebody who looks at the page; without a login `name` is ""."""

    name: str
    role: Role


ANYBODY = User(name="", role="operator")
"""Without a login: whoever can reach the address of this computer."""
