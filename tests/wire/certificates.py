"""A little certificate authority for tests, made by the openssl program."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

OPENSSL = shutil.which("openssl")
needs_openssl = pytest.mark.skipif(OPENSSL is None, reason="openssl is not installed (apt-get install openssl)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Issued:
    """A certificate and its key."""

    cert: Path
    key: Path


class Authority:
    """Signs certificates; those of the past too."""

    def __init__(self, folder: Path, name: str = "ca") -> None:
        folder.mkdir(exist_ok=True)
        self._folder = folder
        self._name = name
        self.cert = folder / f"{name}.crt"
        self._key = folder / f"{name}.key"
        (folder / f"{name}.index").write_text("")
        config = folder / f"{name}.cnf"
        config.write_text(
            f"[ca]\ndefault_ca = one\n[one]\ndatabase = {folder}/{name}.index\nnew_certs_dir = {folder}\n"
            "default_md = sha256\npolicy = any\nrand_serial = yes\ncopy_extensions = copy\nunique_subject = no\n"
            "[any]\ncommonName = supplied\n[req]\ndistinguished_name = name\n[name]\n"
            "[authority]\nbasicConstraints = critical, CA:TRUE\nkeyUsage = keyCertSign\n"
        )
        self._config = config
        _run(
            *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "30"),
            *("-subj", f"/CN={name}", "-keyout", self._key, "-out", self.cert, "-config", config),
            *("-extensions", "authority"),
        )

    def issue(self, name: str, *, begin: str = "20250101000000Z", end: str = "20991231000000Z") -> Issued:
        """A certificate for a common name, which is also its host: valid from `begin` to `end` (YYYYMMDDHHMMSSZ)."""
        stem = self._folder / f"{self._name}-{name}"
        key, request, cert = stem.with_suffix(".key"), stem.with_suffix(".csr"), stem.with_suffix(".crt")
        kind = "IP" if name.replace(".", "").isdigit() else "DNS"
        _run(
            *("req", "-new", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-subj", f"/CN={name}"),
            *("-addext", f"subjectAltName={kind}:{name}", "-keyout", key, "-out", request, "-config", self._config),
        )
        _run(
            *("ca", "-batch", "-notext", "-config", self._config, "-cert", self.cert, "-keyfile", self._key),
            *("-startdate", begin, "-enddate", end, "-in", request, "-out", cert),
        )
        key.chmod(0o600)
        return Issued(cert=cert, key=key)


def _run(*arguments: object) -> None:
    assert OPENSSL is not None
    done = subprocess.run([OPENSSL, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
