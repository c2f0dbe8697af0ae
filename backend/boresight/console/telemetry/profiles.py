"""Saved mapping profiles: a name's versions, none of which ever changes, and the choice among them and the built-in ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from boresight.console import list_queries as lists
from boresight.console.telemetry import queries as rows
from boresight.console.telemetry.tables import ImportProfile
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, utc_now
from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.imports.profile import Profile, parse_profile

NAME_LENGTH = 64


@dataclass(frozen=True)
class OfferedProfile:
    """A profile as it is offered: what an upload names it by, and what it says."""

    key: str
    profile: Profile

    @property
    def title(self) -> str:
        """What a choice shows."""
        return self.key if self.key in BUILT_IN else f"{self.profile.name}, version {self.profile.version}"


def list_offers(session: Session) -> list[OfferedProfile]:
    """Return the built-in profiles, then the newest version of each saved one, by name; one that is read no more is left out."""
    offers = [OfferedProfile(name, profile) for name, profile in BUILT_IN.items()]
    for row in rows.list_profiles_in_use(session):
        with suppress(RefusedInputError):
            offers.append(OfferedProfile(str(row.id), make_profile(row)))
    return offers


def make_profile(row: ImportProfile) -> Profile:
    """Return a saved version."""
    return parse_profile(row.document, f"The stored profile {row.name}")


def find_profile(session: Session, key: str) -> Profile:
    """Return the profile that a built-in name, the number of a saved version, or a saved name, its newest version, names."""
    if key in BUILT_IN:
        return BUILT_IN[key]
    if key.isdecimal() and len(key) < 10:
        return make_profile(get_profile(session, int(key)))
    found = rows.find_newest_profile(session, key[:NAME_LENGTH])
    if found is None or found.archived_utc is not None:
        raise NotFoundError(f"There is no mapping profile {key[:NAME_LENGTH]!r}; choose one from the list.")
    return make_profile(found)


def get_profile(session: Session, profile_id: int) -> ImportProfile:
    """Return a saved version."""
    return session.get_known(ImportProfile, profile_id)


def list_profiles(
    session: Session, *, archived: bool = False, before_id: int | None = None, limit: int | None = None
) -> Sequence[ImportProfile]:
    """Return a page of saved versions, newest first, the archived ones where asked."""
    return lists.list_newest(
        session, ImportProfile, before_id=before_id, limit=limit, in_use=None if archived else True
    )


def save_profile(session: Session, actor: Actor, document: Mapping[str, Any]) -> ImportProfile:
    """Save what a profile says; a name that is there gets its next version."""
    require_role(actor, "analyst")
    require_scope(actor, "telemetry-sets")
    given = parse_profile(document)
    if given.name in BUILT_IN:
        raise RefusedInputError(f"{given.name} is a built-in profile; choose another name.")
    before = rows.find_newest_profile(session, given.name)
    if before is not None and before.archived_utc is None and before.sha256 == given.sha256:
        raise ConflictError(f"Version {before.number} of {given.name} is identical; choose it from the list.")
    profile = replace(given, version=1 if before is None else before.number + 1)
    row = ImportProfile(
        name=profile.name,
        number=profile.version,
        document=profile.to_dict(),
        sha256=profile.sha256,
        created_utc=utc_now(),
        created_by=actor.user_id,
    )
    session.put(row)
    after = {"name": row.name, "number": row.number, "document": row.document, "sha256": row.sha256}
    audit.append(
        session, actor, "saved", f"import-profiles/{row.id}", None if before is None else before.document, after
    )
    return row


def archive_profile(session: Session, actor: Actor, profile_id: int) -> ImportProfile:
    """Take a saved version out of the choice; nothing is deleted."""
    require_role(actor, "analyst")
    require_scope(actor, "telemetry-sets")
    row = get_profile(session, profile_id)
    if row.archived_utc is None:
        row.archived_utc = utc_now()
        audit.append(session, actor, "archived", f"import-profiles/{row.id}")
    return row
