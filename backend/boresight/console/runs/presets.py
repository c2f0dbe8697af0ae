"""Presets: settings under a name, each with a sentence on when to use them; Boresight's own and the mission's.

A saved preset never changes: saving under the same name makes its next version, and an archived one is not offered.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from boresight.calibration.options import CalibrationSettings
from boresight.console import list_queries as lists
from boresight.console.runs import queries
from boresight.console.runs.tables import Preset
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_role, require_scope
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import normal_name, refuse_control_characters

NAME_LENGTH = 60
SENTENCE_LENGTH = 300


@dataclass(frozen=True)
class OfferedPreset:
    """A preset as it is offered."""

    key: str
    name: str
    sentence: str
    chosen: CalibrationSettings

    @property
    def settings(self) -> dict[str, Any]:
        """The settings as a document, every one of them."""
        return self.chosen.document()


def _own(key: str, name: str, sentence: str, **chosen: Any) -> OfferedPreset:
    return OfferedPreset(key, name, sentence, CalibrationSettings.parse(chosen))


BUILT_IN = (
    _own(
        "first-calibration",
        "First calibration",
        "For a new sensor or a new set: all frames at once by least squares, with stars matched again as the parameters improve.",
    ),
    _own(
        "drift-tracking",
        "Drift tracking",
        "When parameters change with temperature or age: frame by frame, allowing a small drift between frames.",
        method="sqrf",
        variant="q",
    ),
    _own(
        "quick-look",
        "Quick look",
        "Soon after a pass: the file's own matches, verified, and few iterations, to see whether a set is worth a full run.",
        match="given",
        max_iterations=10,
    ),
    _own(
        "suspect-matches",
        "Suspect matches",
        "When false stars are likely, after a radiation storm or a bright field: stars that are far off are ignored.",
        robust="stars",
        leave_out_doubles=True,
    ),
    _own(
        "enright",
        "Paper's settings (Enright)",
        "To compare with the paper: its square-root filter without process noise, one linearisation per frame (over-confident).",
        method="sqrf",
        linearisations=1,
    ),
    _own(
        "wu",
        "Wu's singular values",
        "To compare with Wu et al.: singular values of star combinations under Model 4, one linearisation per frame.",
        method="svd",
        linearisations=1,
    ),
)
_BY_KEY = {offer.key: offer for offer in BUILT_IN}


def list_offers(session: Session) -> list[OfferedPreset]:
    """Return the presets on offer: Boresight's own, then the newest version of each of the mission's, by name."""
    return [*BUILT_IN, *map(make_offer, queries.list_presets_in_use(session))]


def make_offer(row: Preset) -> OfferedPreset:
    """Return a saved version as an offer; settings introduced after it was saved are at their defaults."""
    return OfferedPreset(
        str(row.id), f"{row.name}, version {row.number}", row.sentence, CalibrationSettings.parse(row.document)
    )


def _whole(document: Mapping[str, Any]) -> dict[str, Any]:
    return CalibrationSettings.parse(document).document()


def get_offer(session: Session, key: str) -> OfferedPreset:
    """Return the preset that an address names, archived or not."""
    if key in _BY_KEY:
        return _BY_KEY[key]
    if key.isdecimal() and len(key) < 10:
        return make_offer(get_preset(session, int(key)))
    raise NotFoundError(f"There is no preset {key!r}; choose one from the list.")


def get_preset(session: Session, preset_id: int) -> Preset:
    """Return a saved version."""
    return session.get_known(Preset, preset_id)


def list_presets(
    session: Session, *, archived: bool = False, before_id: int | None = None, limit: int | None = None
) -> Sequence[Preset]:
    """Return a page of saved versions, newest first, the archived ones where asked."""
    return lists.list_newest(session, Preset, before_id=before_id, limit=limit, in_use=None if archived else True)


def save_preset(session: Session, actor: Actor, name: str, sentence: str, settings: Mapping[str, Any]) -> Preset:
    """Save settings under a name; an existing name gets its next version."""
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    name, sentence = normal_name("name", name), sentence.strip()
    _refuse_words(name, sentence)
    document = _whole(settings)
    before = queries.find_newest_preset(session, name)
    if (
        before is not None
        and before.archived_utc is None
        and (before.document, before.sentence) == (document, sentence)
    ):
        raise ConflictError(
            f"Version {before.number} of {name} is identical; choose it from the list.", code="identical-version"
        )
    row = Preset(
        name=name,
        number=1 if before is None else before.number + 1,
        sentence=sentence,
        document=document,
        created_utc=utc_now(),
        created_by=actor.user_id,
    )
    session.put(row)
    after = {"name": name, "number": row.number, "sentence": sentence, "settings": document}
    audit.append(session, actor, "saved", f"presets/{row.id}", None if before is None else before.document, after)
    return row


def _refuse_words(name: str, sentence: str) -> None:
    if not name or len(name) > NAME_LENGTH:
        raise RefusedInputError(f"Give the preset a name of up to {NAME_LENGTH} characters.")
    if not sentence or len(sentence) > SENTENCE_LENGTH:
        raise RefusedInputError(
            f"Say in a sentence of up to {SENTENCE_LENGTH} characters when to use {name}.",
            code="preset-without-sentence",
        )
    if name.casefold() in {offer.name.casefold() for offer in BUILT_IN}:
        raise RefusedInputError(f"{name} is a built-in preset; choose another name.")
    refuse_control_characters(sentence=sentence)


def archive_preset(session: Session, actor: Actor, preset_id: int) -> Preset:
    """Take a saved version out of the choice; nothing is deleted."""
    require_role(actor, "analyst")
    require_scope(actor, "runs")
    row = get_preset(session, preset_id)
    if row.archived_utc is None:
        row.archived_utc = utc_now()
        audit.append(session, actor, "archived", f"presets/{row.id}")
    return row


def choose_settings(
    session: Session, preset: str | None, settings: Mapping[str, Any]
) -> tuple[str | None, dict[str, Any]]:
    """Return a preset's name and its settings overridden by the given ones; without a preset the given ones alone."""
    if not preset:
        return None, dict(settings)
    offer = get_offer(session, preset)
    return offer.name, {**offer.settings, **settings}
