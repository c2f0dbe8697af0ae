"""State, cause, level and numbers of a run event are columns; lines that are there get theirs from their sentences.

The hash that chains a line stays as it was. The new columns have one of their own, which goes out from the line's.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

ROWS = 1000
FIELDS = ("state", "cause", "level", "numbers")
LEVELS = {"FAILED": "error", "LOST": "error", "CANCELLED": "warning", "CANCELLING": "warning"}
ATTEMPT = re.compile(r"Attempt \d+: (.*)", re.DOTALL)
PROGRESS = re.compile(r"(\d+) %: ")
COMPUTED = re.compile(r"Computed in (\d+\.\d+) s: ")
AGAIN = "again, because "


def upgrade() -> None:
    """Add the columns and fill them."""
    for name in ("state", "cause", "numbers", "outcome_hash"):
        op.add_column("run_events", sa.Column(name, sa.Text()))
    op.add_column("run_events", sa.Column("level", sa.Text(), nullable=False, server_default="info"))
    names = ("id", "kind", "message", "hash", *FIELDS, "outcome_hash")
    table = sa.table("run_events", *(sa.column(name) for name in names))
    connection, last_id = op.get_bind(), 0
    write = table.update().where(table.c.id == sa.bindparam("of_id"))
    write = write.values({name: sa.bindparam(f"new_{name}") for name in (*FIELDS, "outcome_hash")})
    while True:
        query = sa.select(table.c.id, table.c.kind, table.c.message, table.c.hash)
        rows = connection.execute(query.where(table.c.id > last_id).order_by(table.c.id).limit(ROWS)).all()
        if not rows:
            return
        filled = [(row, _fields(row.kind, row.message)) for row in rows]
        connection.execute(
            write,
            [
                {f"new_{name}": fields[name] for name in ("state", "cause", "level")}
                | {"of_id": row.id, "new_outcome_hash": _hash(row.hash or "", fields)}
                | {"new_numbers": None if fields["numbers"] is None else _canonical(fields["numbers"])}
                for row, fields in filled
            ],
        )
        last_id = rows[-1].id


def downgrade() -> None:
    """Take the columns away; the sentences have what they said."""
    for name in (*FIELDS, "outcome_hash"):
        op.drop_column("run_events", name)


def _fields(kind: str, message: str) -> dict[str, Any]:
    """Read the sentences that versions before this one wrote."""
    fields: dict[str, Any] = {"state": None, "cause": None, "level": "info", "numbers": None}
    if kind == "state":
        state, _, words = message.partition(": ")
        again = state == "QUEUED" and words.startswith(AGAIN)
        cause = words.removeprefix(AGAIN) if state != "RUNNING" else ""
        return fields | {
            "state": state,
            "cause": cause or None,
            "level": "warning" if again else LEVELS.get(state, "info"),
        }
    if found := ATTEMPT.fullmatch(message):
        return fields | {"cause": found[1], "level": "error" if kind == "lost" else "warning"}
    if kind == "lost" or message.startswith("Traceback"):
        return fields | {"level": "error"}
    if found := PROGRESS.match(message):
        return fields | {"numbers": {"fraction": int(found[1]) / 100}}
    if found := COMPUTED.match(message):
        return fields | {"numbers": {"seconds": float(found[1])}}
    return fields


def _canonical(document: dict[str, Any]) -> str:
    return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def _hash(line: str, fields: dict[str, Any]) -> str:
    """Hash what the columns say after the line's own hash."""
    kept = {name: value for name, value in fields.items() if value is not None}
    return hashlib.sha256(f"{line}{_canonical(kept)}".encode()).hexdigest()
