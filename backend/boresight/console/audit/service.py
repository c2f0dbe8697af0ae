"""Anchors of the audit log, made on request."""

from __future__ import annotations

from boresight.errors import ConflictError
from boresight.platform.actors import Actor, require_role
from boresight.platform.audit.anchors import make_anchor
from boresight.platform.audit.signing import SigningKey
from boresight.platform.audit.tables import AuditAnchor
from boresight.platform.db.sessions import Session


def anchor_now(session: Session, actor: Actor, key: SigningKey, broken: str = "") -> AuditAnchor:
    """Sign the newest head, unless an anchor covers it or something was found wrong with the log."""
    require_role(actor, "administrator")
    if broken:
        raise ConflictError(f"The log cannot be signed because it does not verify; find the cause first. {broken}")
    return make_anchor(session, key, actor.printed_name)
