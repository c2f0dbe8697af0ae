"""What a refusal is told apart by: `pytest.raises(ConflictError, check=has_code("already-signed"))`."""

from collections.abc import Callable

from boresight.errors import BoresightError


def has_code(code: str) -> Callable[[BoresightError], bool]:
    return lambda refusal: refusal.code == code
