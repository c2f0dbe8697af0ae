"""Singular values and all angular distances from the command line: on the real star fields, beside the arcs."""

import json

import pytest


def _calibrated(boresight, folder, method):
    words = ("calibrate", folder / "esa-5-frames.csv", "--sensor", folder / "esa.sensor.json", "--json", "-")
    return json.loads(boresight(*words, "--free", "f_m,b2_per_m2", "--method", method).stdout)


@pytest.mark.parametrize("method", ["svd", "angular"])
def test_real_stars_give_the_focal_length_and_b2_that_their_arcs_give(boresight, real_sky, method):
    found, arcs = (_calibrated(boresight, real_sky, each) for each in (method, "batch"))
    assert found["status"] == "converged"
    assert found["rms_arc_rad"]["final"] == pytest.approx(arcs["rms_arc_rad"]["final"], rel=0.02)
    for name in ("f_m", "b2_per_m2"):
        assert abs(found["parameters"][name] - arcs["parameters"][name]) < 2.5 * arcs["sigma"][name]
        assert found["sigma"][name] == pytest.approx(arcs["sigma"][name], rel=0.1)


def test_the_gain_form_of_all_pairs_runs_on_real_stars_and_says_how(boresight, real_sky):
    words = ("calibrate", real_sky / "esa-5-frames.csv", "--sensor", real_sky / "esa.sensor.json", "--json", "-")
    choices = ("--free", "f_m,b2_per_m2", "--match", "given", "--method", "angular", "--gain-form")
    gain, information = (json.loads(boresight(*words, *choices, form).stdout) for form in ("gain", "information"))
    for name in ("f_m", "b2_per_m2"):
        assert gain["parameters"][name] == pytest.approx(information["parameters"][name], rel=1e-6)
        assert gain["sigma"][name] == pytest.approx(information["sigma"][name], rel=1e-6)
    assert any("exposures have more than 2,000 pairs" in sentence for sentence in gain["advice"])
    assert not any("pairs" in sentence for sentence in information["advice"])
