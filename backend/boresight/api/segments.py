"""What a parameter in a path may be, for every route of the server.

A text has no colon: there a verb begins. Or GET of `/runs/5:cancel` would be taken for the run `5:cancel`, refused as malformed,
instead of 405 with the methods that there are. A number has at most as many digits as the store's greatest.
"""

from __future__ import annotations

from starlette.convertors import IntegerConvertor, StringConvertor, register_url_convertor


class Text(StringConvertor):
    """A text up to the next slash or verb."""

    regex = "[^/:]+"


class Number(IntegerConvertor):
    """A number that a row could have."""

    regex = "[0-9]{1,19}"


def register() -> None:
    """Let every path that is compiled from now on take these."""
    register_url_convertor("str", Text())
    register_url_convertor("int", Number())
