"""Checking the stored files that rows name against their addresses and the sizes in their rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import sqlalchemy as sa

from boresight.errors import CorruptFileError, NotFoundError
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.tables import Blob
from boresight.platform.db.declared import Base
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing, utc_now

AT_A_TIME = 500
NAMING = {"source_sha256"}  # columns that name a file without a foreign key
ALTERED, MISSING, RESIZED = "altered", "missing", "of a different size than recorded"
UNTOLD = "called removed, and rows need it"


@dataclass(frozen=True)
class BadFile:
    """A file that differs from its row, with the rows that use it."""

    sha256: str
    what: str
    used_by: tuple[str, ...]

    def __str__(self) -> str:
        """Return a name for the file that people know."""
        return f"{self.sha256[:12]} ({', '.join(self.used_by) or 'of no row'}): {self.what}"


def list_registered(session: Session, after: str) -> Sequence[tuple[str, int]]:
    """Return addresses and sizes of stored files in the order of the addresses, from the one after `after`."""
    query = sa.select(Blob.sha256, Blob.size_bytes).where(Blob.sha256 > after, Blob.removed_utc.is_(None))
    query = query.order_by(Blob.sha256).limit(AT_A_TIME)
    return [(sha256, size) for sha256, size in session.execute(query)]


def list_sizes(session: Session, addresses: Sequence[str]) -> Sequence[tuple[str, int]]:
    """Return addresses and sizes of those files that rows name."""
    query = sa.select(Blob.sha256, Blob.size_bytes).where(Blob.sha256.in_(addresses), Blob.removed_utc.is_(None))
    query = query.order_by(Blob.sha256)
    return [(sha256, size) for sha256, size in session.execute(query)]


@contextmanager
def stored_ahead(engine: Engine, blobs: BlobStore, *contents: bytes) -> Iterator[None]:
    """Store bytes before the transaction whose rows name them; what no row names at the end is removed again.

    It is removed under the lock of a writer, and whoever names it later looks for the file first, so nobody loses a file.
    """
    stored = [blobs.put(content) for content in contents]
    try:
        yield
    finally:
        with open_reading(engine) as session:
            unnamed = set(stored) - dict(list_sizes(session, stored)).keys()
        if unnamed:
            with open_writing(engine) as session:
                for sha256 in unnamed - dict(list_sizes(session, stored)).keys():
                    blobs.discard(sha256)


def count_bytes(session: Session) -> int:
    """Return the total size of stored files by their rows."""
    return (
        session.scalar(sa.select(sa.func.coalesce(sa.func.sum(Blob.size_bytes), 0)).where(Blob.removed_utc.is_(None)))
        or 0
    )


def find_removed(session: Session, sha256: str) -> str | None:
    """Return when a file was removed on purpose; None where it was not."""
    return session.scalar(sa.select(Blob.removed_utc).where(Blob.sha256 == sha256))


def mark_removed(session: Session, addresses: Sequence[str]) -> list[tuple[str, int]]:
    """Mark those files removed that no row needs any more, and return them with their sizes."""
    named = [
        (sha256, size)
        for sha256, size in list_sizes(session, addresses)
        if not list_users(session, sha256, needing=True)
    ]
    for sha256, _ in named:
        session.get_one(Blob, sha256).removed_utc = utc_now()
    return named


def list_removed(session: Session, since_utc: str = "") -> Sequence[str]:
    """Return the files that were removed on purpose since a time."""
    return session.scalars(sa.select(Blob.sha256).where(Blob.removed_utc > since_utc).order_by(Blob.sha256)).all()


def wrong_with(blobs: BlobStore, sha256: str, size: int, *, again: bool) -> str | None:
    """Return what is wrong with a file, or None; it is read once per process, or again on request."""
    try:
        found = blobs.check(sha256, again=again)
    except CorruptFileError:
        return ALTERED
    except NotFoundError:
        return MISSING
    return None if found == size else RESIZED


def bad_files(session: Session, blobs: BlobStore, *, again: bool) -> Iterator[BadFile | None]:
    """Check every file that a row names; yields what is wrong with each, or None."""
    last = ""
    while some := list_registered(session, last):
        for sha256, size in some:
            what = wrong_with(blobs, sha256, size, again=again)
            yield None if what is None else BadFile(sha256, what, list_users(session, sha256))
        last = some[-1][0]
    for sha256 in list_removed(session):
        if users := list_users(session, sha256, needing=True):
            yield BadFile(sha256, UNTOLD, users)


def list_users(session: Session, sha256: str, *, needing: bool = False) -> tuple[str, ...]:
    """Return the rows that name a file, by their REST addresses; `needing` leaves out those whose files were removed on purpose."""
    named = (
        f"{table.name.replace('_', '-')}/{row_id}"
        for table in Base.metadata.sorted_tables
        for key in table.columns
        if key.name in NAMING or any(one.column is Blob.__table__.columns["sha256"] for one in key.foreign_keys)
        for row_id in session.scalars(
            sa.select(table.columns["id"])
            .where(
                key == sha256,
                *([table.columns["removed_utc"].is_(None)] if needing and "removed_utc" in table.columns else []),
            )
            .order_by(table.columns["id"])
        )
    )
    return tuple(dict.fromkeys(named))
