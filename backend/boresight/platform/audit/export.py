"""Exports of the audit log: JSON Lines, alone or in a ZIP with the program that verifies them."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Iterator
from importlib.resources import files
from typing import IO

import boresight
from boresight.errors import RefusedInputError
from boresight.platform.actors import Policy
from boresight.platform.audit import chain
from boresight.platform.audit import queries as rows
from boresight.platform.audit.anchors import spell_line
from boresight.platform.audit.audit_verifier import FORM
from boresight.platform.db.documents import canonical
from boresight.platform.db.sessions import Session, utc_now

FORMS = ("zip", "jsonl")
LINES, VERIFIER, ANCHORS = "audit.jsonl", "verify_audit.py", "anchors.jsonl"
HOW = f"""Boresight's audit log, every record in the order it was written.

  {LINES}       one record a line, as JSON; the last line carries the head of the chain
  {VERIFIER}   verifies it: python3 {VERIFIER} {LINES} [--head HASH]
                     and its anchors by --anchors {ANCHORS} --public-keys KEYS.pem
  {ANCHORS}     the heads that the installation signed, one a line, each with its signature and time-stamp

The log is tamper-evident, not tamper-proof: keep this file, or its head, where the owner of the database cannot reach
it. A later export must still contain the head that you keep: give it with --head.
Public keys that you kept since before (`boresight audit keys`) show that
no anchored record was rewritten.
"""


def verifier() -> str:
    """Return the program that verifies an export, to be kept beside it."""
    return files("boresight.platform.audit").joinpath("audit_verifier.py").read_text(encoding="utf-8")


def write_export(session: Session, stream: IO[bytes], form: str, policy: Policy) -> None:
    """Write the whole log to a stream, as a `zip` with its verifier or as `jsonl` alone."""
    if form not in FORMS:
        raise RefusedInputError(f"There is no export as {form!r}; choose {' or '.join(FORMS)}.")
    if form == "jsonl":
        stream.writelines(_lines(session, policy))
        return
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open(LINES, "w", force_zip64=True) as lines:
            lines.writelines(_lines(session, policy))
        archive.writestr(ANCHORS, "".join(f"{spell_line(anchor)}\n" for anchor, _ in rows.iterate_anchors(session)))
        archive.writestr(VERIFIER, verifier())
        archive.writestr("README.txt", HOW)


def _lines(session: Session, policy: Policy) -> Iterator[bytes]:
    digest, head, count = hashlib.sha256(), chain.FIRST_HASH, 0
    for record in rows.walk(session):
        line = f"{chain.spelled(record)}\n".encode()
        digest.update(line)
        head, count = record["hash"], count + 1
        yield line
    last = {
        "schema": FORM,
        "records": count,
        "head": head,
        "exported_utc": utc_now(),
        "software": f"boresight {boresight.__version__}",
        "four_eyes": policy.four_eyes,
    }
    digest.update(canonical(last).encode())
    yield f"{canonical(last | {'sha256': digest.hexdigest()})}\n".encode()
