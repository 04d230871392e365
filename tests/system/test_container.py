"""The container: labels that BlueOS reads, and its steps in a clean Debian root, where that is wanted."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess

import pytest

from tests.repository import ROOT

CONTAINER = ROOT / "packaging" / "container"


def labels() -> dict[str, str]:
    text = (CONTAINER / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", "")
    found = re.findall(r"""^LABEL (\w+)=(['"])(.*)\2$""", text, re.MULTILINE)
    return {name: value for name, _, value in found}


def test_the_labels_are_what_blueos_reads() -> None:
    found = labels()
    assert {"version", "permissions", "authors", "company", "type", "tags", "readme", "links"} <= found.keys()
    for name in ("permissions", "authors", "company", "tags", "links"):
        json.loads(found[name])
    host = json.loads(found["permissions"])["HostConfig"]
    assert host["NetworkMode"] == "host"
    assert not host.get("Privileged"), "it needs no more than the network and its own folder"
    assert [bind.split(":")[1] for bind in host["Binds"]] == ["/data"]


def test_the_dockerfile_does_nothing_that_is_not_tried_without_docker() -> None:
    steps = re.findall(r"^RUN (.*)$", (CONTAINER / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE)
    assert steps == ["/src/packaging/container/install /src && rm -rf /src"]
    tried = (CONTAINER / "try").read_text(encoding="utf-8")
    assert "/src/packaging/container/install /src" in tried
    for role in ("vehicle", "broker", "web"):
        assert re.search(rf"^run {role} {role} ", tried, re.MULTILINE), role
    assert 'ENTRYPOINT ["/usr/bin/panoexec-container"]' in (CONTAINER / "Dockerfile").read_text(encoding="utf-8")
    assert "/usr/bin/panoexec-container" in tried


@pytest.mark.skipif(not os.environ.get("PANOEXEC_CONTAINER"), reason="minutes, and root: PANOEXEC_CONTAINER=1")
@pytest.mark.skipif(shutil.which("debootstrap") is None or os.geteuid() != 0, reason="needs debootstrap, and root")
def test_its_steps_make_a_page_that_answers_in_a_clean_debian() -> None:
    done = subprocess.run([CONTAINER / "try"], capture_output=True, text=True, timeout=1800, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "the page answers on a vehicle and on the ground" in done.stdout
