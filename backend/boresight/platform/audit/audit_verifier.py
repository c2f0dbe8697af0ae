"""Verify an export of Boresight's audit log with nothing but Python 3.8 or newer; Boresight is not needed.

    python verify_audit.py audit.jsonl [--head HASH]

Each line of the export but the last is one record, as JSON with its keys sorted, without spaces, in UTF-8. With
`canon` that spelling of a record without `id`, `previous_hash` and `hash`, and without `rows` and `roles` where they
are null::

    id_0 = 0,            id_n = id_(n-1) + 1
    hash_0 = 64 zeros,   hash_n = SHA-256(hash_(n-1) || canon(record_n))

A record without `roles` is of an older version, which could skip numbers before it; no other record may follow a gap.
The last line says how many records there are, the hash of the last one, and as `sha256` the SHA-256 of all lines before
it and of the last line itself without that member. Found are: any byte that is not as it was exported, any record
changed, renumbered, removed, added or moved, and with --head a chain that was rewritten after you came to hold one of
its hashes. The exit code is 0 when all is as it was written, 1 otherwise.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from pathlib import Path
from typing import Any, BinaryIO, Dict, Optional, Tuple  # noqa: UP035 - the file runs by itself on Python 3.8 too

FIRST_HASH = "0" * 64
FORM = "boresight.audit-export/1"
NOT_HASHED = ("id", "previous_hash", "hash")
LEFT_OUT_WHEN_NULL = ("rows", "roles")


def canonical(document: Any) -> str:
    """Return the one spelling of a JSON document."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def compute_hash(previous_hash: str, record: Dict[str, Any]) -> str:  # noqa: UP006 - Python 3.8
    """Return the hash that chains a record to the one before."""
    hashed = {
        name: value
        for name, value in record.items()
        if name not in NOT_HASHED and not (name in LEFT_OUT_WHEN_NULL and value is None)
    }
    return hashlib.sha256((previous_hash + canonical(hashed)).encode()).hexdigest()


def read(line: bytes) -> Optional[Dict[str, Any]]:  # noqa: UP006, UP045 - Python 3.8
    """Return the document of a line; None when the line is not spelled as an export spells it."""
    try:
        document = json.loads(line)
        same = isinstance(document, dict) and (canonical(document) + "\n").encode() == line
    except (ValueError, RecursionError):
        return None
    return document if same else None


def verify(export: BinaryIO, expected_head: Optional[str] = None) -> Tuple[bool, str]:  # noqa: UP006, UP045 - Python 3.8
    """Walk through an export."""
    previous, last_id, count, met = FIRST_HASH, 0, 0, expected_head in (None, FIRST_HASH)
    digest = hashlib.sha256()
    for number, line in enumerate(export, start=1):
        document = read(line)
        if document is not None and document.get("schema") == FORM:
            sha256 = document.pop("sha256", None)
            digest.update(canonical(document).encode())
            if (document.get("records"), document.get("head"), sha256) != (count, previous, digest.hexdigest()):
                return (
                    False,
                    f"The last line does not match the {count} records before it: it or one of them was changed.",
                )
            return _end(count, previous, bool(export.read(1)), met)
        if document is None or not _follows(document, previous, last_id):
            return (
                False,
                f"Line {number} is not as it was written, or one before it is missing; the {count} before it are intact.",
            )
        previous, last_id, count = document["hash"], document["id"], count + 1
        met = met or previous == expected_head
        digest.update(line)
    return False, f"The export ends after {count} records without its last line; it was truncated."


def _follows(record: Dict[str, Any], previous: str, last_id: int) -> bool:  # noqa: UP006 - Python 3.8
    """Whether a record is the next one in the chain."""
    number = record.get("id")
    if not isinstance(number, int) or number <= last_id:
        return False
    if number != last_id + 1 and record.get("roles") is not None:
        return False
    return record.get("previous_hash") == previous and record.get("hash") == compute_hash(previous, record)


def _end(count: int, head: str, more: bool, met: bool) -> Tuple[bool, str]:  # noqa: UP006 - Python 3.8
    """Report the result when every line is as it was exported."""
    if more:
        return False, "Something was added after the last line."
    if not met:
        return False, f"The chain of {count} records is intact, but your head is not in it: it was rewritten."
    return True, f"All {count} records are as they were written.\nhead {head}"


def main() -> int:
    """Verify the file that the command line names."""
    parser = argparse.ArgumentParser(description="Verify an export of Boresight's audit log.")
    parser.add_argument("export", help="audit.jsonl")
    parser.add_argument("--head", help="a hash from an earlier export or package, which must still be in the chain")
    arguments = parser.parse_args()
    with Path(arguments.export).open("rb") as export:
        good, sentence = verify(export, arguments.head)
    print(sentence, file=sys.stdout if good else sys.stderr)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
