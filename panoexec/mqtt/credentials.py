"""Credentials for the broker: password and TLS, read from their files at every connection attempt."""

from __future__ import annotations

import ssl
import stat
from pathlib import Path

from panoexec.errors import UsageError
from panoexec.inputs.service_sections import MqttSection


def read_password(settings: MqttSection) -> str | None:
    """Read the password without its trailing line break; None without a file.

    Raises:
        UsageError: the file cannot be read, is empty, or is readable by everybody.
    """
    path = settings.password_file
    if path is None:
        return None
    try:
        mode, text = path.stat().st_mode, path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"mqtt.password_file {path}: cannot be read ({_reason(error)})") from error
    if mode & stat.S_IRWXO:
        raise UsageError(
            f"mqtt.password_file {path}: readable by everybody on this computer (mode {stat.S_IMODE(mode):o}); "
            "chmod 640 and set its group to that of the service"
        )
    password = text.rstrip("\r\n")
    if not password:
        raise UsageError(f"mqtt.password_file {path}: is empty")
    return password


def tls_context(settings: MqttSection) -> ssl.SSLContext | None:
    """The TLS context of the settings; None without a CA file.

    Raises:
        UsageError: a file cannot be read, or is not a certificate or key.
    """
    if settings.ca_file is None:
        return None
    _check_readable("ca_file", settings.ca_file)
    try:
        context = ssl.create_default_context(cafile=str(settings.ca_file))
    except (ssl.SSLError, OSError) as error:
        raise UsageError(f"mqtt.ca_file {settings.ca_file}: contains no certificates ({_reason(error)})") from error
    context.sslsocket_class = _ClosedOnFailure
    if settings.cert_file is not None and settings.key_file is not None:
        _check_readable("cert_file", settings.cert_file)
        _check_readable("key_file", settings.key_file)
        try:
            # without a callback OpenSSL asks for the passphrase on the terminal and blocks
            context.load_cert_chain(settings.cert_file, settings.key_file, password=lambda: "")
        except (ssl.SSLError, OSError, ValueError) as error:
            raise UsageError(
                f"mqtt.cert_file {settings.cert_file} and key_file {settings.key_file}: not a certificate and its key, "
                f"or the key has a passphrase ({_reason(error)})"
            ) from error
    return context


class _ClosedOnFailure(ssl.SSLSocket):
    """A socket that closes itself after a failed handshake, because paho does not."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except (ssl.SSLWantReadError, ssl.SSLWantWriteError):
            raise
        except BaseException:
            self.close()
            raise


def credential_problems(settings: MqttSection) -> list[str]:
    """All problems of the credential files, one line each; without validity dates, which need a correct clock."""
    problems = []
    for check in (read_password, tls_context):
        try:
            check(settings)
        except UsageError as error:
            problems.append(str(error))
    return problems


def _check_readable(key: str, path: Path) -> None:
    try:
        with path.open("rb"):
            pass
    except OSError as error:
        raise UsageError(f"mqtt.{key} {path}: cannot be read ({_reason(error)})") from error


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error) or type(error).__name__
