"""`python -m release`: wheel, source archive, bill of materials, licences, their sums, and with a key the signature of those.

    python -m release [--out dist] [--key FILE] [--no-isolation] [--without-documentation] [--database all.zip] [--accept ID ...]

SOURCE_DATE_EPOCH is the time of the release, by default that of the newest commit; built again with it, anywhere, the files
are the same, byte for byte. FILE holds a private Ed25519 key (PEM). Who has the public one verifies by
`openssl pkeyutl -verify -rawin -pubin -inkey KEYS.pem -sigfile SHA256SUMS.sig -in SHA256SUMS` and `sha256sum -c SHA256SUMS`.
What is known of vulnerabilities of the packages is said last (`release.vulnerabilities`); a known one refuses the release.
"""

from __future__ import annotations

import argparse
import base64
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import boresight
from boresight.platform.audit.signing import SigningKey
from boresight.uplink.archive import sums
from release.licences import ROOT, list_packages, write_list
from release.sbom import write_sbom
from release.vulnerabilities import add_options, scan

EPOCH = "SOURCE_DATE_EPOCH"


def find_epoch() -> int:
    """Return the time of the release, in seconds: as given, or that of the newest commit."""
    if given := os.environ.get(EPOCH):
        return int(given)
    command = ["git", "-C", str(ROOT), "log", "-1", "--format=%ct"]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def build(out: Path, epoch: int, *, isolated: bool) -> list[Path]:
    """Build source archive and wheel, the wheel from the archive."""
    out.mkdir(parents=True, exist_ok=True)
    if before := sorted(out.iterdir()):
        raise SystemExit(f"{out} is not empty ({before[0].name}): remove what is in it, or name another folder.")
    command = [
        sys.executable,
        "-m",
        "build",
        "--outdir",
        str(out),
        *([] if isolated else ["--no-isolation"]),
        str(ROOT),
    ]
    subprocess.run(command, env=os.environ | {EPOCH: str(epoch)}, check=True)
    return sorted(out.iterdir())


def main() -> None:
    """Make a release in a folder."""
    parser = argparse.ArgumentParser(
        prog="python -m release", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    parser.add_argument("--key", type=Path, help="private Ed25519 key that signs the sums")
    parser.add_argument("--no-isolation", action="store_true", help="build with what is installed here")
    parser.add_argument(
        "--without-documentation", action="store_true", help="the console then has no pages under /docs"
    )
    add_options(parser)
    given = parser.parse_args()
    if not given.without_documentation and not (ROOT / "build" / "documentation" / "index.html").is_file():
        raise SystemExit("There is no documentation to release in build/documentation: run `make docs` first.")
    packages = list(list_packages())
    if refused := [f"{one.name} ({one.licence or 'unknown'})" for one in packages if not one.is_allowed]:
        raise SystemExit(
            f"Licences that are not allowed: {', '.join(refused)}. Replace the packages, or change ALLOWED."
        )
    scanned = scan(packages, given.database).left_by(given.accept)
    if scanned.found:
        raise SystemExit(
            "\n".join(
                [
                    *scanned.lines(),
                    "Update these packages by `make lock`, or name with --accept what does not concern Boresight.",
                ]
            )
        )
    epoch = find_epoch()
    built = build(given.out, epoch, isolated=not given.no_isolation)
    files = {file.name: file.read_bytes() for file in built}
    (wheel,) = (content for name, content in files.items() if name.endswith(".whl"))
    made = datetime.fromtimestamp(epoch, UTC)
    files["boresight.cdx.json"] = write_sbom(boresight.__version__, wheel, packages, made).encode()
    files["LICENCES.md"] = write_list(packages).encode()
    files["SHA256SUMS"] = sums(files)
    if given.key is not None:
        signer = SigningKey(given.key.read_text()).load()
        files["SHA256SUMS.sig"] = base64.b64decode(signer.sign(files["SHA256SUMS"]))
    for name, content in files.items():
        (given.out / name).write_bytes(content)
    print(files["SHA256SUMS"].decode(), end="")
    print(f"signed by {signer.public.id}" if given.key is not None else "not signed: give --key")
    print("\n".join(scanned.lines()))


if __name__ == "__main__":
    main()
