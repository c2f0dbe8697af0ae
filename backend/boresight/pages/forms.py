"""What a form sent: its texts, and the version that its page showed."""

from __future__ import annotations

from collections.abc import Mapping

from fastapi import Request
from starlette.datastructures import FormData

from boresight.api.numbers import row_number
from boresight.errors import RefusedInputError


def texts_of(form: FormData) -> dict[str, str]:
    """Return the texts of a form, without its files."""
    return {name: value for name, value in form.items() if isinstance(value, str)}


async def read_texts(request: Request) -> dict[str, str]:
    """Read the texts of the form that a request carries."""
    return texts_of(await request.form())


def seen_version(form: Mapping[str, str]) -> int:
    """Return the version that the page showed.

    Raises
    ------
    RefusedInputError
        When the form does not carry it.
    """
    version = row_number(form.get("version", ""))
    if version is None:
        raise RefusedInputError("The form does not say which version you saw; reload the page and do it again.")
    return version
