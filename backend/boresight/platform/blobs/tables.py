"""Stored files."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base, Sealing


class Blob(Base):
    """A content-addressed file; the bytes are in the blob folder under their SHA-256."""

    __tablename__ = "blobs"
    __table_args__ = (STRICT,)
    sealing = Sealing(
        unsealed="is named by the SHA-256 of its bytes; the rows that name it are sealed, and lose it if it is edited"
    )
    sha256: Mapped[str] = mapped_column(sa.Text, primary_key=True)
    size_bytes: Mapped[int] = mapped_column(sa.BigInteger().with_variant(sa.Integer, "sqlite"))
    media_type: Mapped[str] = mapped_column(sa.Text)
    created_utc: Mapped[str] = mapped_column(sa.Text)
    removed_utc: Mapped[str | None] = mapped_column(sa.Text)  # on purpose; the rows that name it say so, and are sealed
