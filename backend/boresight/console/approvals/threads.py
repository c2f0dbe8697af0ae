"""Threads of a request: comments on one gate, parameter or figure, open until somebody resolves them.

A comment is a remark that belongs to a thread, and like every remark is never edited. `@name` mentions a person by log-in name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from boresight.console.access import queries as user_rows
from boresight.console.approvals import queries as rows
from boresight.console.approvals.review import VIEWS
from boresight.console.approvals.tables import Approval, Remark, Thread
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.transitions import move, name_subject, require_seen
from boresight.errors import ConflictError, NotFoundError, RefusedInputError
from boresight.platform.actors import Actor, require_person, require_role
from boresight.platform.audit import log as audit
from boresight.platform.audit.subjects import AuditAction
from boresight.platform.db.sessions import Session, utc_now
from boresight.platform.web.text_validation import refuse_control_characters
from boresight.verdicts.gates import GATES

LONGEST_REMARK = 4000
MENTION = re.compile(r"(?<![\w@.])@([\w.-]*\w)")
RESOLVED = {"resolved": "RESOLVED", "reopened": "OPEN"}


def add_remark(session: Session, actor: Actor, approval_id: int, text: str, thread_id: int | None = None) -> Remark:
    """Add a remark to a request, decided or not, or to one of its threads."""
    user_id = _require_voice(actor)
    approval = session.get_known(Approval, approval_id)
    if thread_id is not None:
        get_thread(session, approval_id, thread_id)
    refuse_control_characters(remark=text)
    if not text.strip() or len(text) > LONGEST_REMARK:
        raise RefusedInputError(
            f"A comment of {len(text.strip())} characters cannot be stored; write 1 to {LONGEST_REMARK}."
        )
    row = Remark(
        approval_id=approval.id,
        user_id=user_id,
        printed_name=actor.printed_name,
        text=text.strip(),
        made_utc=utc_now(),
        thread_id=thread_id,
        mentions=_find_mentions(session, text) or None,
    )
    session.put(row)
    told = {"text": row.text} | ({} if thread_id is None else {"thread": thread_id})
    audit.append(session, actor, AuditAction.REMARKED, f"{name_subject(approval)}/remarks/{row.id}", None, told)
    return row


def _require_voice(actor: Actor) -> int:
    """Return the number of a person who may take part in discussions."""
    user_id = require_person(actor, "discuss a request")
    require_role(actor, "analyst", "operator", "approver", "administrator")
    return user_id


def _find_mentions(session: Session, text: str) -> list[str]:
    """Return the log-in names that a text mentions, each once; refuse one that nobody has."""
    named = list(dict.fromkeys(MENTION.findall(text)))
    known = {user.name for user in user_rows.list_users(session)} if named else set()
    for name in named:
        if name not in known:
            raise RefusedInputError(
                f"Nobody here has the log-in name {name[:64]!r}; correct it, or leave out the @ before it."
            )
    return named


def find_open_mentions(session: Session) -> dict[str, list[Remark]]:
    """Return what mentions whom, by log-in name, newest first: remarks that wait for an answer.

    A mention waits until that person has said something in the same place, the thread is resolved, or the request is decided.
    """
    waiting: dict[str, list[Remark]] = {}
    found = rows.list_mentioning_remarks(session)
    if not found:
        return waiting
    requests = {remark.approval_id for remark in found}
    resolved = rows.list_resolved_threads(session, requests)
    said = rows.list_answers(session, requests)
    ids = {user.name: user.id for user in user_rows.list_users(session)}
    last = {(approval, thread, user): remark for remark, approval, thread, user in sorted(said)}
    for remark in reversed(found):
        for name in remark.mentions or ():
            answered = last.get((remark.approval_id, remark.thread_id, ids.get(name, 0)), 0) > remark.id
            if remark.thread_id not in resolved and not answered:
                waiting.setdefault(name, []).append(remark)
    return waiting


def list_threads(session: Session, approval_id: int) -> Sequence[Thread]:
    """Return the threads of a request, in order."""
    return rows.list_threads(session, session.get_known(Approval, approval_id).id)


def get_thread(session: Session, approval_id: int, thread_id: int) -> Thread:
    """Return a thread of a request."""
    row = session.get_known(Thread, thread_id)
    if row.approval_id != approval_id:
        raise NotFoundError(f"Request {approval_id} has no thread {thread_id}; choose one from its list.")
    return row


def open_thread(session: Session, actor: Actor, approval_id: int, kind: str, name: str, text: str) -> Thread:
    """Open a thread about a gate, a parameter or a figure, with its first comment."""
    user_id = _require_voice(actor)
    approval = session.get_known(Approval, approval_id)
    _refuse_unknown(session.get_one(ParameterSet, approval.parameter_set_id), kind, name)
    row = Thread(
        approval_id=approval_id,
        kind=kind,
        name=name,
        state="OPEN",
        version=1,
        opened_by=user_id,
        printed_name=actor.printed_name,
        opened_utc=utc_now(),
    )
    session.put(row)
    audit.append(session, actor, "opened", name_subject(row), None, {"state": "OPEN", "kind": kind, "name": name})
    add_remark(session, actor, approval_id, text, row.id)
    return row


def _refuse_unknown(row: ParameterSet, kind: str, name: str) -> None:
    known = {"gate": list(GATES), "parameter": list(row.document["parameters"]), "figure": list(VIEWS)}
    if kind not in known:
        raise RefusedInputError(f"A thread cannot be about {kind[:64]!r}; choose one of {', '.join(known)}.")
    if name not in known[kind]:
        raise RefusedInputError(f"There is no {kind} {name[:64]!r}; choose one of {', '.join(known[kind])}.")


def set_resolved(
    session: Session, actor: Actor, approval_id: int, thread_id: int, action: str, seen_version: int | None
) -> Thread:
    """Resolve a thread, or reopen it: `resolved` or `reopened`."""
    user_id = _require_voice(actor)
    row = get_thread(session, approval_id, thread_id)
    require_seen(session, row, seen_version)
    state = RESOLVED[action]
    if row.state == state:
        raise ConflictError(f"Thread {row.id} is {row.state} already; reload the page.")
    is_resolved = state == "RESOLVED"
    row.resolved_by = user_id if is_resolved else None
    row.resolver = actor.printed_name if is_resolved else None
    row.resolved_utc = utc_now() if is_resolved else None
    move(session, actor, row, state, action)
    return row
