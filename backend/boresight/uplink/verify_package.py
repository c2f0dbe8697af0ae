"""Verify an uplink package of Boresight with Python 3.8 or newer and the library `cryptography`; Boresight is not needed.

    python verify_package.py PACKAGE.zip PUBLIC_KEYS.pem

Each file must be in SHA256SUMS with its SHA-256, each file named there must be in the package once, and SHA256SUMS.sig must be the
Ed25519 signature of SHA256SUMS by one of the public keys. Keep this program and the keys where no package comes from: those that
come with a package prove nothing of it. Exit code 0: as it was exported; 1: do not load it.
"""

from __future__ import annotations

import hashlib
import re
import sys
import zipfile
from pathlib import Path
from typing import Dict  # noqa: UP035 - the file runs by itself on Python 3.8 too

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_public_key

SUMS, SIGNATURE, LARGEST_BYTES = "SHA256SUMS", "SHA256SUMS.sig", 1 << 30
PEM = re.compile(rb"-----BEGIN PUBLIC KEY-----.*?-----END PUBLIC KEY-----", re.DOTALL)


def verify(package: Path, public_keys: bytes) -> str:
    """Return the id of the key that signed the package; raise ValueError where anything is not as it was exported."""
    with zipfile.ZipFile(package) as packed:
        names = packed.namelist()
        if len(set(names)) < len(names) or sum(one.file_size for one in packed.infolist()) > LARGEST_BYTES:
            raise ValueError("a file is in it twice, or it unpacks to more than 1 GiB")
        files: Dict[str, bytes] = {name: packed.read(name) for name in names}  # noqa: UP006 - Python 3.8
    if SUMS not in files or SIGNATURE not in files:
        raise ValueError("it is not signed")
    listed = "".join(
        f"{hashlib.sha256(files[name]).hexdigest()}  {name}\n" for name in sorted({*names} - {SUMS, SIGNATURE})
    )
    if listed.encode() != files[SUMS]:
        raise ValueError("a file was changed, added or removed")
    for pem in PEM.findall(public_keys):
        key = load_pem_public_key(pem)
        try:
            if isinstance(key, Ed25519PublicKey):
                key.verify(files[SIGNATURE], files[SUMS])
                return hashlib.sha256(key.public_bytes(Encoding.Raw, PublicFormat.Raw)).hexdigest()[:16]
        except InvalidSignature:
            continue
    raise ValueError("none of your public keys signed it")


if __name__ == "__main__":
    try:
        key = verify(Path(sys.argv[1]), Path(sys.argv[2]).read_bytes())
        sys.stdout.write(f"OK: the package is unchanged since export, signed by {key}\n")
    except (IndexError, OSError, ValueError, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        sys.exit(f"DO NOT LOAD: {error}" if len(sys.argv) > 2 else __doc__)
