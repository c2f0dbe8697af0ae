"""Documents: one spelling each."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.platform.db.documents import canonical, compute_sha256, read

NUMBERS = (
    st.integers(-(2**63), 2**63)
    | st.integers()
    | st.integers(10**17, 10**40)
    | st.floats(allow_nan=False, allow_infinity=False)
)
JSON = st.recursive(
    st.none() | st.booleans() | NUMBERS | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=20,
)


@given(document=JSON)
def test_a_document_read_back_has_the_same_spelling(document: object) -> None:
    assert canonical(json.loads(canonical(document))) == canonical(document)


@given(document=JSON)
def test_the_fast_reader_reads_what_the_plain_one_does(document: object) -> None:
    spelling = canonical(document)
    assert repr(read(spelling)) == repr(json.loads(spelling))


@given(document=st.dictionaries(st.text(max_size=8), JSON, min_size=2))
def test_the_order_of_keys_does_not_matter(document: dict[str, object]) -> None:
    backwards = dict(reversed(document.items()))
    assert compute_sha256(backwards) == compute_sha256(document)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), float("-inf")])
def test_what_json_cannot_say_is_refused(number: float) -> None:
    with pytest.raises(ValueError, match="JSON compliant"):
        canonical({"f_m": number})


def test_the_spelling_is_fixed() -> None:
    document = {"b": [1.0, 1e22, -0.0, 0.1], "a": {"ψ": None, "n": 3}}
    assert canonical(document) == '{"a":{"n":3,"ψ":null},"b":[1.0,1e+22,-0.0,0.1]}'
