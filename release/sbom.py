"""A software bill of materials in CycloneDX: the wheel, and each package of the lock file with its hashes and its licence.

The same inputs give the same bytes: the serial number follows from the content, and the time is that of the release.
"""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Sequence
from datetime import datetime

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from packageurl import PackageURL

from release.licences import Package


def write_sbom(version: str, wheel: bytes, packages: Sequence[Package], made: datetime) -> str:
    """Return the bill of a wheel as JSON, CycloneDX 1.6."""
    own = _component("boresight", version, "MIT", (hashlib.sha256(wheel).hexdigest(),), ComponentType.APPLICATION)
    parts = [_component(one.name, one.version, one.licence, one.sha256s) for one in packages]
    bom = Bom(components=parts)
    bom.metadata.component, bom.metadata.timestamp = own, made
    bom.register_dependency(own, parts)
    named = "".join(f"{one.name}=={one.version} {one.licence} {one.sha256s}\n" for one in packages)
    bom.serial_number = uuid.uuid5(uuid.NAMESPACE_URL, f"boresight=={version} {own.hashes} {named}")
    return str(JsonV1Dot6(bom).output_as_string(indent=1))


def _component(
    name: str, version: str, licence: str, sha256s: Sequence[str], kind: ComponentType = ComponentType.LIBRARY
) -> Component:
    address = PackageURL("pypi", name=name, version=version)
    return Component(
        name=name,
        version=version,
        type=kind,
        purl=address,
        bom_ref=str(address),
        licenses=[LicenseFactory().make_from_string(licence)] if licence else [],
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=sha256s[0])] if len(sha256s) == 1 else [],
    )
