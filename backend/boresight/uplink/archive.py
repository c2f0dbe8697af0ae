"""Files into one ZIP whose bytes follow from theirs alone: sorted by name, dated 1980, stored and not compressed.

Compressed bytes differ between versions of the compressor; these files are small.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Mapping

FIRST_DATE = (1980, 1, 1, 0, 0, 0)
UNIX = 3
PLAIN_FILE = 0o100644 << 16


def sums(files: Mapping[str, bytes]) -> bytes:
    """Write the SHA-256 of every file as `sha256sum -c` reads it."""
    lines = (f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in sorted(files.items()))
    return "".join(lines).encode()


def archive(files: Mapping[str, bytes]) -> bytes:
    """Put files into a ZIP."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as packed:
        for name, content in sorted(files.items()):
            entry = zipfile.ZipInfo(name, FIRST_DATE)
            entry.create_system = UNIX
            entry.external_attr = PLAIN_FILE
            packed.writestr(entry, content)
    return buffer.getvalue()
