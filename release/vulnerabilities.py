"""`python -m release.vulnerabilities`: which packages of the lock file have known vulnerabilities.

    python -m release.vulnerabilities [--database all.zip] [--accept ID ...]

With `--database` no network is needed: it is a folder or an archive of records in the OSV format, as osv.dev publishes one for each
ecosystem (`PyPI/all.zip`). Without it `pip-audit` asks its database, where it is installed and the network allows it. A package
that could not be looked up is never counted as sound: exit code 0 says that all were and nothing was found, 1 that something was,
3 that it is not known.

A version v of a package is affected where a record lists it, or where the last event at or below v, in the order of versions, of
one of its ranges is `introduced`; `fixed` ends a range before v, `last_affected` after it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

from release.licences import ROOT, Package, list_packages

FOUND, UNKNOWN = 1, 3
LOCK = ROOT / "requirements.lock"


@dataclass(frozen=True)
class Vulnerability:
    """A known flaw of a package in the version that is installed, by all of its names."""

    package: str
    version: str
    names: tuple[str, ...]
    summary: str


@dataclass(frozen=True)
class Scan:
    """What a scan found; `unknown` says what could not be looked up, and why."""

    looked_up: int
    found: tuple[Vulnerability, ...]
    unknown: tuple[str, ...]

    def left_by(self, accepted: Sequence[str]) -> Scan:
        """Return it without the vulnerabilities that were accepted by one of their names."""
        return Scan(self.looked_up, tuple(one for one in self.found if not {*one.names} & {*accepted}), self.unknown)

    @property
    def exit_code(self) -> int:
        """0 where everything was looked up and nothing found."""
        return FOUND if self.found else UNKNOWN if self.unknown else 0

    def lines(self) -> Iterator[str]:
        """Say it, a line each."""
        for one in self.found:
            yield f"{one.package} {one.version}: {', '.join(one.names)} {one.summary}".rstrip()
        yield from (f"Not scanned: {reason}" for reason in self.unknown)
        if self.looked_up:
            yield f"{self.looked_up} packages looked up, {len(self.found)} known vulnerabilities."


def scan_offline(packages: Sequence[Package], database: Path) -> Scan:
    """Hold the packages against OSV records in a folder or an archive."""
    by_name = {canonicalize_name(one.name): one for one in packages}
    found, records = [], 0
    for record in _read_records(database):
        records += 1
        for affected in () if record.get("withdrawn") else record.get("affected", ()):
            of = affected.get("package", {})
            package = by_name.get(canonicalize_name(of.get("name", ""))) if of.get("ecosystem") == "PyPI" else None
            if package is not None and is_affected(package.version, affected):
                names = (record["id"], *record.get("aliases", ()))
                found.append(Vulnerability(package.name, package.version, names, record.get("summary", "")))
    if not records:
        return Scan(0, (), (f"{database} holds no record in the OSV format: download it again.",))
    return Scan(len(packages), tuple(dict.fromkeys(found)), ())


def _read_records(database: Path) -> Iterator[dict[str, Any]]:
    if database.is_dir():
        yield from (json.loads(path.read_bytes()) for path in sorted(database.rglob("*.json")))
        return
    with zipfile.ZipFile(database) as archive:
        yield from (json.loads(archive.read(name)) for name in sorted(archive.namelist()) if name.endswith(".json"))


def is_affected(version: str, affected: dict[str, Any]) -> bool:
    """Whether an entry of a record's `affected` means a version; what cannot be compared counts as affected."""
    if version in affected.get("versions", ()):
        return True
    try:
        return any(
            _within(Version(version), one["events"])
            for one in affected.get("ranges", ())
            if one["type"] in {"ECOSYSTEM", "SEMVER"}
        )
    except InvalidVersion:
        return True


def _within(version: Version, events: Sequence[dict[str, str]]) -> bool:
    """Whether a version lies in a range: what the last event at or below it says."""
    told = [(Version(at), kind) for event in events for kind, at in event.items() if kind != "limit"]
    inside = False
    for at, kind in sorted(told):
        if at > version or (at == version and kind == "last_affected"):
            break
        inside = kind == "introduced"
    return inside


def scan_online(packages: Sequence[Package]) -> Scan:
    """Have `pip-audit` ask its database; what it skips is not known."""
    command = [sys.executable, "-m", "pip_audit", "--requirement", str(LOCK), "--require-hashes", "--disable-pip"]
    done = subprocess.run(
        [*command, "--format", "json", "--progress-spinner", "off"], capture_output=True, text=True, check=False
    )
    try:
        told = json.loads(done.stdout)["dependencies"]
    except (ValueError, KeyError):
        why = (done.stderr.strip().splitlines() or ["it said nothing"])[-1].rpartition(": ")[2]
        reason = f"no offline database is here, and pip-audit gave no answer ({why}): give --database, or install it."
        return Scan(0, (), (reason,))
    return read_answer(told, packages)


def read_answer(told: Sequence[dict[str, Any]], packages: Sequence[Package]) -> Scan:
    """Read what `pip-audit` says of each dependency."""
    known = {canonicalize_name(one["name"]): one for one in told if "skip_reason" not in one}
    missing = [one.name for one in packages if canonicalize_name(one.name) not in known]
    found = [
        Vulnerability(one["name"], one["version"], (flaw["id"], *flaw.get("aliases", ())), "")
        for one in known.values()
        for flaw in one.get("vulns", ())
    ]
    reason = f"the database did not answer for {len(missing)} packages, {missing[0]} among them." if missing else ""
    return Scan(len(known), tuple(found), (reason,) if reason else ())


def scan(packages: Sequence[Package], database: Path | None) -> Scan:
    """Scan by the database that is at hand."""
    return scan_online(packages) if database is None else scan_offline(packages, database)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what a scan can be told."""
    parser.add_argument("--database", type=Path, help="OSV records: a folder, or an archive such as PyPI/all.zip")
    parser.add_argument("--accept", action="append", default=[], help="a vulnerability that does not concern Boresight")


def main() -> None:
    """Scan, and say what was found."""
    parser = argparse.ArgumentParser(
        prog="python -m release.vulnerabilities",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser)
    given = parser.parse_args()
    told = scan(list(list_packages()), given.database).left_by(given.accept)
    print("\n".join(told.lines()))
    sys.exit(told.exit_code)


if __name__ == "__main__":
    main()
