"""Which roles one person may hold together."""

from __future__ import annotations

from collections.abc import Collection

from boresight.errors import RefusedInputError
from boresight.store.tables import ROLES


def known_roles(roles: Collection[str]) -> list[str]:
    """Return the roles in the table's order, each once.

    Raises
    ------
    RefusedInputError
        When a role does not exist, or an administrator, who gives roles and passwords, would also sign.
    """
    if isinstance(roles, str) or (unknown := sorted(set(roles) - set(ROLES))):
        named = roles if isinstance(roles, str) else ", ".join(unknown)
        raise RefusedInputError(f"There is no role {named}; the roles are {', '.join(ROLES)}.")
    if {"administrator", "approver"} <= set(roles):
        raise RefusedInputError("An administrator cannot sign; give the role approver to another person.")
    return [role for role in ROLES if role in roles]
