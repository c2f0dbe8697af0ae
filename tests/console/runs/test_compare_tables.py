"""The tables of a comparison as they are printed."""

from types import SimpleNamespace

import pytest

from boresight.console.runs.pages.compare import together


@pytest.mark.parametrize(("p", "said"), [(0.0, "p < 10⁻³⁰⁰"), (0.25, "p = 0.25")])
def test_no_chance_is_nought_however_large_chi_square_is(p, said):
    found = SimpleNamespace(reference=0, contrasts=[None, SimpleNamespace(joint=(51_280.0, 8, p))])
    assert together(found)[1].note.endswith(said)
