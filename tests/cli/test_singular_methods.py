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
