"""What an audit record changed, as people read it."""

import pytest

from boresight.console.audit.pages import changes, find_unit, name_member


@pytest.mark.parametrize(
    ("name", "title", "unit"),
    [
        ("ground_state", "On ground", ""),
        ("initial.f_m", "Initial, f", "mm"),
        ("typical_sigma.b2_per_m2", "Typical sigma, b2", "m⁻²"),
        ("detector.pixel_pitch_m", "Detector, Pixel pitch", "m"),
        ("centroid_sigma_px", "Centroid sigma", "px"),
        ("bound.incumbent_sha256", "Bound, Incumbent, SHA-256", ""),
        ("expires_utc", "Expires", ""),
        ("must_change_password", "Must set a password of their own", ""),
    ],
)
def test_a_member_has_a_name_and_the_unit_it_is_shown_in(name: str, title: str, unit: str) -> None:
    assert (name_member(name), find_unit(name)) == (title, unit)


def test_parameters_are_shown_in_the_units_that_operators_think_in() -> None:
    (found,) = changes({"initial": {"f_m": 0.016}}, {"initial": {"f_m": 0.0161}})
    assert (found.before, found.after, found.unit) == ("16", "16.1", "mm")


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (True, "yes"),
        (False, "no"),
        ([], "none"),
        (["viewer", "analyst"], "viewer, analyst"),
        ("2026-11-21T03:04:05.123456Z", "2026-325 03:04:05Z"),
        ("c" * 64, "cccccccc"),
        (7, "7"),
        (1.0 / 3.0, "0.3333333"),
        ([1, 2], "[1, 2]"),
        ("x" * 200, "x" * 120 + "…"),
    ],
)
def test_a_value_is_printed_for_people(value: object, shown: str) -> None:
    assert changes(None, {"thing": value})[0].after == shown
