"""Keeps MAVSDK from downloading anything by itself.

MAVSDK 4.1 fetches the camera definition that a camera names as soon as it finds the camera: from any host, of any size,
into a cache in the user's home. Whoever can send a message to the link could have this computer ask any host. It cannot
be switched off, but its HTTP client (libcurl) obeys the environment: a proxy that is nowhere lets no request out. What
panoexec itself fetches does not look there (`panoexec.adapters.files.http_worker`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, MutableMapping
from typing import Final

_NOWHERE: Final = "http://127.0.0.1:9"
"""The discard port: nothing listens there."""
_PROXIES: Final = ("http_proxy", "https_proxy", "HTTPS_PROXY", "ftp_proxy", "FTP_PROXY", "all_proxy", "ALL_PROXY")
_EXCEPTIONS: Final = ("no_proxy", "NO_PROXY")


@contextlib.contextmanager
def no_downloads(environment: MutableMapping[str, str]) -> Iterator[None]:
    """Change the environment of this process so for the block, in which links are opened.

    Args:
        environment: `os.environ`.
    """
    forbidden = dict.fromkeys(_PROXIES, _NOWHERE) | dict.fromkeys(_EXCEPTIONS, "")
    before = {name: environment.get(name) for name in forbidden}
    environment.update(forbidden)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                environment.pop(name, None)
            else:
                environment[name] = value
