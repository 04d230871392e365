"""What is wrong with section `[web]` beyond its syntax: needs neither the broker nor the packages of the server."""

from __future__ import annotations

import ssl

from panoexec.errors import InputFileError, UsageError
from panoexec.inputs.service_sections import WebSection, listen_address
from panoexec.web.access import is_loopback
from panoexec.web.users import read_users


def web_problems(section: WebSection) -> list[str]:
    """Why the server would not start, one line each; empty if it would."""
    problems = []
    host, _ = listen_address(section.listen)
    if section.users_file is None:
        if not is_loopback(host):
            problems.append(needs_users(host))
    else:
        try:
            read_users(section.users_file)
        except InputFileError as error:
            problems += [f"web.users_file {error.source}: {problem}" for problem in error.problems]
    try:
        server_tls(section)
    except UsageError as error:
        problems.append(str(error))
    return problems


def needs_users(host: str) -> str:
    """Why an address cannot be listened at without users."""
    return (
        f"{host} can be reached by others: make users with panoexec web --add-user NAME and name their file as"
        " users_file in [web], or listen at 127.0.0.1"
    )


def server_tls(section: WebSection) -> ssl.SSLContext | None:
    """The TLS context of the server; None without a certificate.

    Raises:
        UsageError: certificate or key cannot be used.
    """
    if section.cert_file is None or section.key_file is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        # without a callback OpenSSL asks for the passphrase on the terminal and blocks
        context.load_cert_chain(section.cert_file, section.key_file, password=lambda: "")
    except (OSError, ValueError) as error:
        raise UsageError(f"web.cert_file {section.cert_file}, key_file {section.key_file}: {error}") from error
    return context
