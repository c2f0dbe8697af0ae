"""What single charts promise: levels, hatching, orientation, significance."""

import numpy as np
import pytest

from boresight.figures import FIGURES, Trace
from boresight.figures.charts import radial as radial_contrast
from boresight.figures.history import settled_step, summarise_tail, tailed
from boresight.figures.style.axes import EXTRAPOLATED
from boresight.verdicts.verdict import sigma_of_rms


def named(drawn, name):
    return [trace for trace in drawn.data if trace.name == name]


def test_rms_is_in_microradians_with_the_initial_and_the_final_level(sequential_result):
    drawn = FIGURES["rms"].draw([Trace("Run", sequential_result)])
    assert named(drawn, "initial parameters")[0].y[0] == pytest.approx(412.9)
    assert named(drawn, "final parameters")[0].y[0] == pytest.approx(82.6)
    assert "µrad" in drawn.layout.yaxis.title.text


def test_the_tail_and_the_aggregate_are_told_apart_by_dash(sequential_result):
    drawn = FIGURES["rms"].draw([Trace("Run", sequential_result)])
    assert named(drawn, "Run · tail")[0].line.dash == "solid"
    assert named(drawn, "Run · aggregate")[0].line.dash == "dot"


def test_the_tail_begins_where_the_run_had_settled_or_where_a_reader_wants_it(sequential_result):
    had_settled = settled_step(sequential_result)
    for trace, start in (
        (Trace("Run", sequential_result), had_settled),
        *((one, 50) for one in tailed([Trace("Run", sequential_result)], 50)),
        *(
            (one, 40) for one in [Trace("Run", sequential_result | {"status": "running"})]
        ),  # the first fifth is left out
    ):
        whole, tail = named(FIGURES["rms"].draw([trace]), "Run · tail")
        assert min(whole.x) == 0
        assert min(tail.x) == pytest.approx(start, abs=1)


def test_the_tail_s_mean_and_its_sigma_are_those_of_the_window(sequential_result):
    (trace,) = tailed([Trace("Run", sequential_result)], 100)
    tail = summarise_tail(trace.result)
    mean = np.mean(sequential_result["history"]["tail_rms_rad"][100:])
    assert (tail.points, tail.chosen) == (100, True)
    assert tail.tail_rad == pytest.approx(mean)
    assert tail.sigma_rad == pytest.approx(mean / np.sqrt(2 * sequential_result["pairs"]))


def test_an_rms_of_n_arcs_scatters_by_its_sigma():
    arcs = np.random.default_rng(3).normal(size=(4000, 200))
    rms = np.sqrt(np.mean(arcs**2, axis=1))
    assert rms.std() == pytest.approx(sigma_of_rms(1.0, 200), rel=0.05)


@pytest.mark.parametrize(("name", "panels"), [("distortion", 1), ("radial", 2)])
def test_radii_without_stars_are_hatched_from_the_outermost_star_on_and_named_once(name, panels, sequential_result):
    hatched = named(FIGURES[name].draw([Trace("Run", sequential_result)]), "no stars: extrapolated")
    assert [(min(one.x), max(one.x)) for one in hatched] == [(1440.0, 1620.0)] * panels
    assert {one.fillpattern.shape for one in hatched} == {"/"}
    assert [one.showlegend for one in hatched].count(True) == 1


def test_new_minus_old_displacement_is_the_radial_difference(sequential_result):
    drawn = FIGURES["distortion"].draw([Trace("Run", sequential_result)])
    (new,), (old,) = named(drawn, "Run"), named(drawn, "old: at launch")
    assert np.array(new.y) - np.array(old.y) == pytest.approx(sequential_result["radial"]["difference_px"], abs=1e-5)


def test_a_result_from_before_the_curves_were_kept_says_how_to_have_them(sequential_result):
    radial = {key: value for key, value in sequential_result["radial"].items() if key != "displacement_px"}
    drawn = FIGURES["distortion"].draw([Trace("Run", sequential_result | {"radial": radial})])
    assert "start it again" in drawn.layout.annotations[0].text


def test_correlations_are_the_covariance_over_the_sigmas_and_name_the_strongest_pair():
    P = np.array([[4.0, -5.4], [-5.4, 9.0]])
    result = {"covariance": {"names": ["f_m", "b2_per_m2"], "matrix": P.tolist()}, "parameters": {"f_m": 1.0}}
    drawn = FIGURES["correlation"].draw([Trace("Run", result)])
    assert np.array(drawn.data[0].z, float)[0, 1] == pytest.approx(-0.9)
    assert np.isnan(np.array(drawn.data[0].z, float)[0, 0])
    assert "−0.9: read them together" in drawn.layout.title.text
    assert FIGURES["correlation"].table(result)["correlation"] == pytest.approx([1.0, -0.9, 1.0])


def test_maps_beside_each_other_have_short_titles_and_one_set_of_row_labels(sequential_result, batch_result):
    short = ["Run 12", "Run 13"]
    labels = [f"{run} · Square-root filter, fed as frames come down" for run in short]
    traces = list(map(Trace, labels, (sequential_result, batch_result), short))
    drawn = FIGURES["coverage"].draw(traces)
    assert [title.text for title in drawn.layout.annotations] == short
    assert (drawn.layout.yaxis.showticklabels, drawn.layout.yaxis2.showticklabels) == (True, False)
    assert labels[1] in drawn.data[1].hovertemplate


def test_maps_of_unlike_detectors_keep_their_row_labels_apart(sequential_result):
    shorter = sequential_result["coverage"] | {"row_edges_px": np.linspace(-0.5, 1023.5, 10).tolist()}
    drawn = FIGURES["coverage"].draw(
        [Trace("Run 1", sequential_result), Trace("Run 2", sequential_result | {"coverage": shorter})]
    )
    assert drawn.layout.yaxis2.showticklabels
    assert drawn.layout.xaxis2.domain[0] - drawn.layout.xaxis.domain[1] >= 0.19


def test_the_arcsecond_axis_is_the_pixel_axis_by_the_plate_scale(sequential_result):
    drawn = FIGURES["radial"].draw([Trace("Run", sequential_result)])
    ratio = np.array(drawn.layout.yaxis2.range) / np.array(drawn.layout.yaxis.range)
    assert ratio == pytest.approx(28.3, rel=1e-6)


def test_runs_of_unlike_plate_scale_get_no_arcsecond_axis(sequential_result):
    radial = sequential_result["radial"]
    doubled = {key: [2 * v for v in radial[key]] for key in ("difference_arcsec", "sigma_arcsec")}
    other = sequential_result | {"radial": radial | doubled}
    drawn = FIGURES["radial"].draw([Trace("one", sequential_result), Trace("other", other)])
    assert drawn.layout.yaxis2.range is None


def test_each_direction_is_a_column_with_its_largest_share_positive(sequential_result):
    heat = FIGURES["observability"].draw([Trace("Run", sequential_result)]).data[-1]
    shares = np.array(heat.z, dtype=float)
    expected = np.array(sequential_result["observability"]["right_singular_vectors"]).T
    assert np.abs(shares) == pytest.approx(np.abs(expected), abs=1e-6)
    assert np.all(shares[np.argmax(np.abs(shares), axis=0), np.arange(8)] > 0)


def test_the_condition_number_and_the_weakest_direction_are_said_in_words(sequential_result):
    drawn = FIGURES["observability"].draw([Trace("Run", sequential_result)])
    assert "150" in drawn.layout.title.text
    assert any("m0 and a2 move together" in annotation.text for annotation in drawn.layout.annotations)


def test_an_undetermined_direction_is_called_infinite(sequential_result):
    seen = sequential_result["observability"]
    singular = [*seen["singular_values"][:-1], 0.0]
    rank_deficient = seen | {"singular_values": singular, "condition_number": None}
    drawn = FIGURES["observability"].draw([Trace("Run", sequential_result | {"observability": rank_deficient})])
    assert "infinite" in drawn.layout.title.text


def test_the_first_detector_row_is_at_the_top_and_empty_cells_are_gaps(sequential_result):
    drawn = FIGURES["coverage"].draw([Trace("Run", sequential_result)])
    counts = np.array(sequential_result["coverage"]["counts"])
    cells = np.array(drawn.data[0].z, dtype=float)
    assert drawn.layout.yaxis.autorange == "reversed"
    assert np.array_equal(np.isnan(cells), counts == 0)


def test_a_change_within_three_sigma_is_paler(sequential_result):
    still = sequential_result["initial"] | {"f_m": sequential_result["parameters"]["f_m"]}
    drawn = FIGURES["parameters"].draw([Trace("Run", sequential_result | {"parameters": still})])
    colours = drawn.data[0].marker.color
    assert colours[0] == "#3b8fe0"
    assert all(colour.startswith("rgba") for colour in colours[1:])
    assert "1 of 8" in drawn.layout.title.text


def test_compared_runs_stand_beside_each_other_in_both_halves(sequential_result, batch_result):
    drawn = FIGURES["parameters"].draw([Trace("one", sequential_result), Trace("other", batch_result)])
    assert [trace.offsetgroup for trace in drawn.data] == ["one", "one", "other", "other"]


def test_the_parameter_table_holds_si_values(sequential_result):
    columns = FIGURES["parameters"].table(sequential_result)
    assert columns["final"][0] == sequential_result["parameters"]["f_m"]
    assert columns["delta_over_sigma"][0] == pytest.approx(sequential_result["delta_over_sigma"]["f_m"])


def test_radii_that_no_star_of_both_runs_reached_are_hatched_over_the_height_of_the_comparison():
    curve = {
        "radius_px": [0.0, 500.0, 1000.0],
        "difference_px": [0.0, 1.0, 4.0],
        "sigma_px": [0.0, 0.1, 0.5],
        "difference_arcsec": [0.0, 28.0, 112.0],
        "sigma_arcsec": [0.0, 2.8, 14.0],
        "data_radius_px": 700.0,
    }
    drawn = radial_contrast.draw_radial_contrast(["one", "other"], 0, [None, curve])
    (hatched,) = named(drawn, EXTRAPOLATED)
    assert hatched.fillpattern.shape == "/"
    assert (min(hatched.x), max(hatched.x)) == (700.0, 1000.0)
    assert min(hatched.y) < 0.0
    assert max(hatched.y) > 4.0 + 3 * 0.5
    whole = radial_contrast.draw_radial_contrast(["one", "other"], 0, [None, {**curve, "data_radius_px": 1000.0}])
    assert named(whole, EXTRAPOLATED) == []
