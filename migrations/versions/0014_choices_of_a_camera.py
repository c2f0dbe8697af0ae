"""A run may choose a camera for the data of another; lists keep to calibrations.

The way back leaves such runs as rows: they are sealed records. An older version lists them under the method `choice`, with a result
that it refuses to read, and its audit log says that they lost a column.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

#: Indexes before, and with the column, which every list of calibrations narrows by.
INDEXES = {
    "ix_runs_sensor_id": (["sensor_id"], ["sensor_id", "choice_of", "id"]),
    "ix_runs_state_id": (["state", "id"], ["state", "id", "choice_of"]),
    "ix_runs_sensor_state_id": (
        ["sensor_id", "state", "id", "ended_utc"],
        ["sensor_id", "state", "choice_of", "id", "ended_utc"],
    ),
}


def upgrade() -> None:
    """Add the column; without a foreign key, for which SQLite would copy the table. No run is ever removed."""
    op.add_column("runs", sa.Column("choice_of", sa.Integer(), nullable=True))
    op.create_index("ix_runs_choice_of", "runs", ["choice_of"])
    for name, (_, columns) in INDEXES.items():
        op.drop_index(name, "runs")
        op.create_index(name, "runs", columns)


def downgrade() -> None:
    """Take the column away."""
    for name, (columns, _) in INDEXES.items():
        op.drop_index(name, "runs")
        op.create_index(name, "runs", columns)
    op.drop_index("ix_runs_choice_of", "runs")
    op.drop_column("runs", "choice_of")
