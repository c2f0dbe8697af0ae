"""Verify an export of Boresight's audit log with nothing but Python 3.8 or newer; Boresight is not needed.

    python verify_audit.py audit.jsonl [--head HASH] [--anchors anchors.jsonl --public-keys KEYS.pem]

Each line of the export but the last is one record, as JSON with its keys sorted, without spaces, in UTF-8. With
`canon` that spelling of a record without `id`, `previous_hash` and `hash`, and without `rows` and `roles` where they
are null::

    id_0 = 0,            id_n = id_(n-1) + 1
    hash_0 = 64 zeros,   hash_n = SHA-256(hash_(n-1) || canon(record_n))

A record without `roles` is of an older version, which could skip numbers before it; no other record may follow a gap.
The last line says how many records there are, the hash of the last one, and as `sha256` the SHA-256 of all lines before
it and of the last line itself without that member. Found are: any byte that is not as it was exported, any record
changed, renumbered, removed, added or moved, and with --head a chain that was rewritten after you came to hold one of
its hashes. With --anchors, each line of which is a head that the installation signed, and public keys that you kept
(those that come with an export prove nothing), a chain that was rewritten or cut after it was signed by one of them is
found too; this alone needs the library `cryptography`. An anchor by any other key is a fault.
The exit code is 0 when all is as it was written, 1 otherwise.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import re
import sys
from pathlib import Path
from typing import Any, BinaryIO, Dict, Optional, Tuple  # noqa: UP035 - the file runs by itself on Python 3.8 too

Heads = Dict[int, str]  # noqa: UP006 - Python 3.8; the head that was signed at each record
FIRST_HASH = "0" * 64
FORM = "boresight.audit-export/1"
SIGNED = ("schema", "record", "head", "at_utc", "made_by", "key")
PEM = re.compile(rb"-----BEGIN PUBLIC KEY-----.*?-----END PUBLIC KEY-----", re.DOTALL)
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


def read_anchors(lines: bytes, public_keys: bytes) -> Heads:
    """Return the head that was signed at each record; raise ValueError at one that none of the public keys signed."""
    from cryptography.exceptions import InvalidSignature  # noqa: PLC0415 - without anchors nothing but Python is needed
    from cryptography.hazmat.primitives.serialization import load_pem_public_key  # noqa: PLC0415 - as above

    keys: Any = [load_pem_public_key(pem) for pem in PEM.findall(public_keys)]
    heads: Heads = {}
    for number, line in enumerate(lines.splitlines(), start=1):
        try:
            anchor = json.loads(line)
            statement = canonical({name: anchor[name] for name in SIGNED}).encode()
            signature, record, head = base64.b64decode(anchor["signature"]), int(anchor["record"]), str(anchor["head"])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"Line {number} of the anchors was altered.") from error
        for key in keys:
            try:
                key.verify(signature, statement)
                break
            except InvalidSignature:
                continue
        else:
            raise ValueError(
                f"Anchor {number}, of record {record}, is signed by none of your public keys, or was changed."
            )
        heads[record] = head
    if not heads:
        raise ValueError("No anchors found: nothing has been signed yet, or the anchors were removed.")
    return heads


def verify(
    export: BinaryIO,
    expected_head: Optional[str] = None,  # noqa: UP045 - Python 3.8
    anchored: Optional[Heads] = None,  # noqa: UP045 - Python 3.8
) -> Tuple[bool, str]:  # noqa: UP006 - Python 3.8
    """Walk through an export, whose chain is to have the heads that were anchored."""
    anchored = anchored or {}
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
            if max(anchored, default=0) > last_id:
                return (
                    False,
                    f"An anchor signs record {max(anchored)}, and the export ends at {last_id}: the end was cut.",
                )
            return _end(count, previous, bool(export.read(1)), met, anchored)
        if document is None or not _follows(document, previous, last_id):
            return (
                False,
                f"Line {number} was altered, or an earlier line is missing; the {count} lines before it are intact.",
            )
        previous, last_id, count = document["hash"], document["id"], count + 1
        if anchored.get(last_id, previous) != previous:
            return (
                False,
                f"Record {last_id} is not the one that an anchor signs: the log was rewritten after it was signed.",
            )
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


def _end(count: int, head: str, more: bool, met: bool, anchored: Heads) -> Tuple[bool, str]:  # noqa: UP006 - Python 3.8
    """Report the result when every line is as it was exported."""
    if more:
        return False, "Something was added after the last line."
    if not met:
        return (
            False,
            f"The chain of {count} records is intact, but the head you gave is not in it: the log was rewritten.",
        )
    signed = f" Your keys signed {len(anchored)} heads, up to record {max(anchored)}." if anchored else ""
    return True, f"All {count} records are intact.{signed}\nhead {head}"


def main() -> int:
    """Verify the file that the command line names."""
    parser = argparse.ArgumentParser(description="Verify an export of Boresight's audit log.")
    parser.add_argument("export", help="audit.jsonl")
    parser.add_argument("--head", help="a hash from an earlier export or package, which must still be in the chain")
    parser.add_argument("--anchors", help="anchors.jsonl, the heads that the installation signed")
    parser.add_argument("--public-keys", help="the public keys (PEM) that you kept, from `boresight audit keys`")
    arguments = parser.parse_args()
    if (arguments.anchors is None) != (arguments.public_keys is None):
        parser.error("give --anchors and --public-keys together")
    try:
        anchored = None
        if arguments.anchors is not None:
            anchored = read_anchors(Path(arguments.anchors).read_bytes(), Path(arguments.public_keys).read_bytes())
        with Path(arguments.export).open("rb") as export:
            good, sentence = verify(export, arguments.head, anchored)
    except ValueError as error:
        good, sentence = False, str(error)
    print(sentence, file=sys.stdout if good else sys.stderr)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
