"""The numbers of rows as requests name them: what the store's 64-bit keys can hold."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Le

GREATEST_ID = 2**63 - 1

Id = Annotated[int, Ge(1), Le(GREATEST_ID)]
