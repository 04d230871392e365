"""Write the bill of materials (CycloneDX 1.6, JSON) of a staged tree: what the package contains, not what it asked for.

Usage: python packaging/sbom.py TREE ARCHITECTURE OUTPUT.cdx.json, with cyclonedx-python-lib (PyPI) installed.
"""

from __future__ import annotations

import hashlib
import sys
from importlib.metadata import Distribution, distributions
from pathlib import Path

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import HashAlgorithm, HashType, Property
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

LIBRARY = "usr/lib/panoexec"
PANNELLUM = "panoexec/report/assets/pannellum"


def main(tree: Path, architecture: str, output: Path) -> None:
    """Write the bill of materials of `tree`; raises FileNotFoundError if it is not a staged tree."""
    library = tree / LIBRARY
    found = sorted(distributions(path=[str(library)]), key=lambda distribution: distribution.name.lower())
    if "panoexec" not in {distribution.name for distribution in found}:
        raise FileNotFoundError(f"{library} does not contain panoexec: run packaging/stage first")
    licences = LicenseFactory()
    components = {distribution.name: _component(distribution, licences) for distribution in found}
    root = components.pop("panoexec")
    root.type = ComponentType.APPLICATION
    root.properties.add(Property(name="debian:architecture", value=architecture))
    viewer = Component(
        name="pannellum", version=(library / PANNELLUM / "VERSION").read_text().strip(), type=ComponentType.LIBRARY,
        bom_ref="pannellum", licenses=[licences.make_from_string("MIT")],
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=_sha256(library / PANNELLUM / "pannellum.js"))],
    )  # fmt: skip
    bom = Bom(components=[*components.values(), viewer])
    bom.metadata.component = root
    bom.register_dependency(root, [*components.values(), viewer])
    output.write_text(JsonV1Dot6(bom).output_as_string(indent=2) + "\n")


def _component(distribution: Distribution, licences: LicenseFactory) -> Component:
    metadata = distribution.metadata
    text = metadata.get("License-Expression") or _short(metadata.get("License")) or _classifier(distribution)
    # RECORD lists every installed file with its SHA-256: its own hash names the content of the whole wheel
    record = next(file for file in distribution.files or () if file.name == "RECORD")
    return Component(
        name=distribution.name, version=distribution.version, type=ComponentType.LIBRARY,
        bom_ref=f"{distribution.name}=={distribution.version}",
        purl=PackageURL("pypi", name=distribution.name.lower(), version=distribution.version),
        licenses=[licences.make_from_string(text)] if text else [],
        description=metadata.get("Summary"),
        properties=[Property(name="wheel:record:sha256", value=_sha256(Path(str(distribution.locate_file(record)))))],
    )  # fmt: skip


def _short(text: str | None) -> str | None:
    """The field if it names a licence; some wheels put the licence's whole text there."""
    return text if text and "\n" not in text else None


def _classifier(distribution: Distribution) -> str | None:
    found = [line for line in distribution.metadata.get_all("Classifier") or () if line.startswith("License ::")]
    return found[0].rsplit(" :: ", 1)[-1] if found else None


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))
