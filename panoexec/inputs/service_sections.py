"""Sections of the configuration about the broker, storage, the operator's page and the log."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from panoexec.inputs.sections import (
    NotNegative,
    Section,
    is_ipv6,
)

_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")

_ORIGIN = re.compile(r"https?://([A-Za-z0-9_.-]{1,253}|\[[0-9A-Fa-f:.]+\])(:\d{1,5})?")

_HOST_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,252}")


class MqttSection(Section):
    """`[mqtt]`: broker and credentials; without `host` there is no MQTT connection."""

    host: str | None = None
    port: Annotated[int, Field(ge=1, le=65535)] = 1883
    prefix: str = "panoexec"
    protocol: Literal["5", "3.1.1"] = "5"
    keepalive_s: Annotated[int, Field(ge=5, le=3600)] = 20
    discovery: bool = False
    username: str | None = None
    password_file: Path | None = None
    ca_file: Path | None = None
    cert_file: Path | None = None
    key_file: Path | None = None

    @field_validator("host")
    @classmethod
    def _host_is_a_host(cls, value: str | None) -> str | None:
        if value is not None and not _HOST_NAME.fullmatch(value) and not is_ipv6(value):
            # the part before an @ may be a password, which must not appear in messages
            shown = "the value" if "@" in value else repr(value)
            raise ValueError(f"{shown} is not a host: give a name or an address without mqtt:// and without a port")
        return value

    @field_validator("prefix")
    @classmethod
    def _prefix_is_a_topic(cls, value: str) -> str:
        if not all(_ID.fullmatch(part) for part in value.split("/")):
            raise ValueError(
                f"{value!r} is not a topic prefix: use levels of A-Z a-z 0-9 _ - separated by single slashes"
            )
        return value

    @model_validator(mode="after")
    def _credentials_are_whole(self) -> Self:
        if (self.cert_file is None) != (self.key_file is None):
            raise ValueError("cert_file and key_file belong together: set both or neither")
        if self.cert_file is not None and self.ca_file is None:
            raise ValueError("cert_file needs ca_file: client certificates require TLS")
        if self.password_file is not None and self.username is None:
            raise ValueError("password_file needs username")
        return self


class StorageSection(Section):
    """`[storage]`: storage of missions."""

    path: Path = Path("/var/lib/panoexec")
    min_free_mb: NotNegative = 200.0


class WebSection(Section):
    """`[web]`: the operator's page (`panoexec web`)."""

    listen: str = "127.0.0.1:8090"
    users_file: Path | None = None
    cert_file: Path | None = None
    key_file: Path | None = None
    origins: tuple[str, ...] = ()

    @field_validator("listen")
    @classmethod
    def _listen_is_an_address(cls, value: str) -> str:
        listen_address(value)
        return value

    @field_validator("origins")
    @classmethod
    def _origins_are_origins(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for origin in value:
            if not _ORIGIN.fullmatch(origin):
                raise ValueError(f'{origin!r} is not an origin: give scheme and host, "https://ground.example"')
        return value

    @model_validator(mode="after")
    def _certificate_has_a_key(self) -> Self:
        if (self.cert_file is None) != (self.key_file is None):
            raise ValueError("cert_file and key_file belong together: set both or neither")
        return self


def listen_address(text: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT`, `[IPV6]:PORT` or `PORT`.

    Raises:
        ValueError: it is none.
    """
    host, _, port = text.rpartition(":")
    host = host[1:-1] if host.startswith("[") and host.endswith("]") and is_ipv6(host[1:-1]) else host
    host = host or "127.0.0.1"
    if not (port.isdecimal() and int(port) <= 65_535) or not (_HOST_NAME.fullmatch(host) or is_ipv6(host)):
        raise ValueError(f"{text!r} is not an address to listen at: give HOST:PORT, for example 127.0.0.1:8090")
    return host, int(port)


class LogSection(Section):
    """`[log]`: level and format of the log."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["auto", "human", "json"] = "auto"
