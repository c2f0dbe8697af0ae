"""How much a telemetry file may hold, whatever its format: told before anything is expanded, in time linear in its bytes."""

from __future__ import annotations

from dataclasses import dataclass

from boresight.errors import RefusedInputError


@dataclass(frozen=True)
class Limits:
    """Limits of one telemetry file."""

    rows: int = 50_000_000
    columns: int = 1_000
    name_bytes: int = 255
    cell_bytes: int = 4_096
    line_bytes: int = 1_000_000
    expanded_bytes: int = 64_000_000
    expansion: int = 64
    stars: int = 10_000

    def expanded(self, file_bytes: int) -> int:
        """How many bytes a file of this size may need when it is read."""
        return self.expanded_bytes + self.expansion * file_bytes

    def refuse_rows(self, name: str, rows: int) -> None:
        """Refuse more rows than may be."""
        if rows > self.rows:
            raise RefusedInputError(f"{name} has over {self.rows:,} rows: split it, or raise BORESIGHT_TELEMETRY_ROWS.")

    def refuse_columns(self, name: str, columns: int) -> None:
        """Refuse more columns than may be."""
        if columns > self.columns:
            raise RefusedInputError(
                f"{name} has {columns:,} columns, at most {self.columns:,} are read: export only the columns that are needed, or "
                "raise BORESIGHT_TELEMETRY_COLUMNS."
            )

    def refuse_names(self, name: str, columns: tuple[str, ...]) -> None:
        """Refuse names of columns that are too long."""
        for number, column in enumerate(columns, start=1):
            if len(column.encode("utf-8", "surrogatepass")) > self.name_bytes:
                raise RefusedInputError(
                    f"{name}: the name of column {number} is over {self.name_bytes} bytes long: give it a short name."
                )

    def refuse_expansion(self, name: str, needed: int, file_bytes: int) -> None:
        """Refuse a file that needs too many bytes when it is read."""
        if needed > self.expanded(file_bytes):
            raise RefusedInputError(
                f"{name} would take over {self.expanded(file_bytes) / 1e6:,.0f} MB when read, more than {self.expansion} times its "
                "size: leave out columns that repeat one long text, and export it again.",
                code="expands-too-far",
            )


LIMITS = Limits()
#: Of a table of our own: it was held to limits when it came, whatever they were then.
STORED = Limits(rows=2**62, columns=2**31, expansion=2**31)
