"""Views of pages that people saved under a name, for themselves or for everybody."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from boresight.platform.db.declared import STRICT, Base, Sealing
from boresight.platform.db.documents import TypedText


class SavedView(Base):
    """The address of a page as somebody looked at it, with filters, zoom and cursor; a favourite is of an object's page."""

    __tablename__ = "saved_views"
    noun = "saved view"
    __table_args__ = (sa.UniqueConstraint("user_id", "path"), STRICT)
    sealing = Sealing(unsealed="is an address under a name that its owner makes and removes; it decides nothing")
    id: Mapped[int] = mapped_column(primary_key=True)
    user_id: Mapped[int] = mapped_column(sa.ForeignKey("users.id"))
    name: Mapped[str] = mapped_column(TypedText)
    path: Mapped[str] = mapped_column(sa.Text)
    favourite: Mapped[int]
    shared: Mapped[int]
    made_utc: Mapped[str] = mapped_column(sa.Text)
