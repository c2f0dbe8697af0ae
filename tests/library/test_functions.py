"""Each function of the library does what its command does, on what is in memory, and answers with values."""

import copy
import dataclasses
import inspect
import json
import sys
from collections.abc import Sequence
from typing import get_type_hints

import numpy as np
import plotly.graph_objects as go
import pytest

import boresight as bs
from boresight.calibration.options import OPTIONS, CalibrationSettings
from boresight.figures import FIGURES
from boresight.library.keywords import CalibrationKeywords, ChoiceKeywords, EvaluationKeywords
from boresight.sky import catalogue
from boresight.waiting import tell
from tests.refusals import has_code


def test_a_calibration_is_near_the_truth(cal, simulated):
    assert cal.status == "converged"
    for name in cal.free:
        assert abs(cal.parameters[name] - simulated.truth[name]) < 5 * cal.sigma[name]
    assert np.sqrt(np.diag(np.asarray(cal.covariance))) == pytest.approx(
        [cal.sigma[name] for name in cal.covariance.names]
    )


def test_names_complete_and_a_wrong_one_is_named(cal):
    assert cal.parameters.f_m == cal.parameters["f_m"]
    assert "f_m" in dir(cal.parameters)
    with pytest.raises(AttributeError, match="f_mm"):
        _ = cal.parameters.f_mm


def test_a_terminal_shows_every_parameter_and_all_advice(cal):
    text = repr(cal)
    for word in ("converged", "sigma", "verdict", "m0", "g_y", *cal.advice):
        assert word in text


def test_a_notebook_shows_a_table_and_drawings_without_script_and_network(cal):
    page = cal._repr_html_()
    assert page.count("<tr") == 1 + len(cal.parameters)
    assert page.count("<svg") == 2
    assert "<script" not in page
    assert "http" not in page


@pytest.fixture(scope="module")
def answers(simulated, cal):
    stars, sensor = simulated.telemetry, simulated.sensor
    return {
        "Quality": bs.check(stars, sensor),
        "Matches": bs.match(stars, sensor),
        "Evaluation": bs.evaluate(simulated.validation, sensor, cal, shadow=True),
        "Choice": bs.choose(stars, sensor, validate=simulated.validation),
        "Assessment": bs.assess(cal, sensor),
    }


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Quality", ["30 frames", "severity"]),
        ("Matches", ["stars matched", "removed", "frames valid"]),
        ("Evaluation", ["availability", "RMS arc error, µrad", "95 %"]),
        ("Choice", ["inverted_wang", "above", "µrad"]),
        ("Assessment", ["gate", "PASS", "measured"]),
    ],
)
def test_every_other_answer_is_short_in_a_terminal_and_a_table_in_a_notebook(name, words, answers):
    text, page = repr(answers[name]), answers[name]._repr_html_()
    assert type(answers[name]) is getattr(bs, name)
    for word in words:
        assert word in text
        assert word in page
    assert len(text) < 6000
    assert text.count("\n") < 60
    assert page.count("<tr") == page.count("</tr>") > 1
    assert "<script" not in page
    assert "http" not in page


def test_what_an_answer_shows_is_escaped_in_a_notebook(answers):
    assert "<b>" not in dataclasses.replace(answers["Assessment"], sensor="<b>ST")._repr_html_()


def test_every_figure_draws_and_its_name_is_listed(cal):
    assert cal.figures == tuple(FIGURES)
    assert isinstance(cal.draw("convergence"), go.Figure)
    assert len(cal.table("convergence")) > 1
    with pytest.raises(bs.RefusedInputError, match="convergence"):
        cal.draw("divergence")


def test_several_calibrations_are_drawn_over_one_another(cal, tmp_path):
    cal.save(tmp_path / "cal.json")
    both = bs.draw({"one": cal, "two": tmp_path / "cal.json"}, "convergence", theme="dark")
    assert {"one", "two"} <= {trace.name for trace in both.data}
    assert len(both.data) > len(bs.draw(cal, "convergence").data)


@pytest.mark.parametrize("kind", ["polars", "pyarrow"])
def test_parameters_as_a_frame(kind, cal):
    frame = cal.to_frame(kind)
    assert type(frame).__module__.startswith(kind)
    assert [str(name) for name in frame["parameter"]] == list(cal.parameters)


def test_what_is_saved_is_loaded_as_it_was(cal, tmp_path):
    cal.save(tmp_path / "cal.json")
    assert bs.load(tmp_path / "cal.json") == cal
    assert bs.load(json.loads(cal.to_json())) == cal
    cal.report(tmp_path / "cal.html")
    assert "</html>" in (tmp_path / "cal.html").read_text()


@pytest.mark.parametrize(
    "settings",
    [{"free": "f_m,b2_per_m2"}, {"free": ["f_m", "b2_per_m2"]}, {"free": ("f_m", "b2_per_m2"), "method": "sqrf"}],
    ids=["text", "list", "filter"],
)
def test_settings_are_those_of_the_command(settings, simulated):
    found = bs.calibrate(simulated.telemetry, simulated.sensor, progress=False, **settings)
    assert found.free == ["f_m", "b2_per_m2"]
    assert found.method == settings.get("method", "batch")
    assert set(found.inputs.settings.stated) == set(OPTIONS)


@pytest.mark.parametrize("settings", [{"method": "guess"}, {"free": "f"}, {"metod": "batch"}, {"max_iterations": 0}])
def test_a_setting_that_does_not_exist_is_refused_in_one_sentence(settings, simulated):
    with pytest.raises(bs.RefusedInputError) as refused:
        bs.calibrate(simulated.telemetry, simulated.sensor, **settings)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("function", "settings", "code"),
    [
        ("calibrate", {"method": "batch", "variant": "q"}, "setting-of-another-method"),
        ("calibrate", {"linearisations": 3}, "setting-of-another-method"),
        ("choose", {"free": "f_m"}, "unknown-setting"),
        ("evaluate", {"free": "f_m"}, "unknown-setting"),
        ("evaluate", {"method": "ekf"}, "unknown-setting"),
    ],
)
def test_a_setting_that_the_function_or_the_method_does_not_take_is_refused(function, settings, code, simulated, cal):
    sources = (simulated.telemetry, simulated.sensor, *([cal] if function == "evaluate" else []))
    with pytest.raises(bs.RefusedInputError, match=list(settings)[-1], check=has_code(code)):
        getattr(bs, function)(*sources, **settings)


def test_the_spread_of_the_start_counts_under_every_method_for_matching_begins_with_it(simulated):
    found = bs.calibrate(simulated.telemetry, simulated.sensor, progress=False, initial_sigma_scale=3.0)
    assert (found.method, found.inputs.settings.initial_sigma_scale) == ("batch", 3.0)


WRONG_WHOLES = [("frames", 0), ("frames", -3), ("frames", 2.5), ("frames", True), ("seed", "a"), ("seed", -1)]


@pytest.mark.parametrize(("name", "value"), WRONG_WHOLES)
def test_what_is_no_whole_number_of_a_scenario_is_refused(name, value):
    with pytest.raises(bs.RefusedInputError, match=f"`{name}` must be a whole number"):
        bs.simulate("st16-1", **{name: value})


def test_images_are_simulated_of_whole_numbers_of_frames_into_a_folder_alone(tmp_path):
    with pytest.raises(bs.RefusedInputError, match="`frames` must be a whole number"):
        bs.simulate_images("st16-1", 0, tmp_path)
    with pytest.raises(bs.RefusedInputError, check=has_code("other-form")):
        bs.simulate_images("st16-1", 1, None)


@pytest.mark.parametrize(
    "ask",
    [
        lambda made, _: bs.calibrate(made.telemetry, None),
        lambda made, _: bs.calibrate(made.telemetry, [made.scenario["sensor"]]),
        lambda made, _: bs.evaluate(made.telemetry, made.sensor, None),
        lambda made, _: bs.evaluate(made.telemetry, made.sensor, 3),
        lambda made, _: bs.assess(None, made.sensor),
        lambda made, cal: bs.assess(cal, made.sensor, profile=3),
        lambda _, cal: bs.draw([cal, cal], "parameters"),
        lambda *_: bs.load(None),
        lambda *_: bs.simulate(None),
    ],
    ids=["no sensor", "list of sensors", "nothing", "number", "assessed", "profile", "drawn", "loaded", "simulated"],
)
def test_what_has_another_form_is_refused_with_the_forms_that_are_taken(ask, simulated, cal):
    with pytest.raises(bs.RefusedInputError, match="give ", check=has_code("other-form")):
        ask(simulated, cal)


def test_what_is_saved_is_saved_to_a_path(simulated, cal):
    for answer in (cal, simulated, bs.match(simulated.telemetry, simulated.sensor)):
        with pytest.raises(bs.RefusedInputError, check=has_code("unwritable")):
            answer.save(None)


def test_every_setting_is_typed_by_its_kind():
    typed = get_type_hints(CalibrationSettings)
    kinds = {
        "word": str, "whole": int, "number": float, "yes or no": bool, "names": tuple[str, ...],
        "numbers": tuple[str, ...], "times": tuple[str, ...], "wholes": tuple[int, ...], "stars": tuple[int, ...],
    }  # fmt: skip
    assert typed == {
        name: kinds[one.kind] | None if one.default is None else kinds[one.kind] for name, one in OPTIONS.items()
    }


def test_type_checkers_know_every_setting_by_the_type_that_is_declared():
    lists = {tuple[str, ...]: str | Sequence[str], tuple[int, ...]: str | Sequence[int]}
    lists |= {kind | None: wide | None for kind, wide in lists.items()}
    declared = {name: lists.get(kind, kind) for name, kind in get_type_hints(CalibrationSettings).items()}
    assert get_type_hints(CalibrationKeywords) == declared
    for function, keywords in ((bs.choose, ChoiceKeywords), (bs.evaluate, EvaluationKeywords)):
        taken = [name for name in inspect.signature(function).parameters if name in OPTIONS]
        assert get_type_hints(keywords) == {name: declared[name] for name in taken}


def test_a_list_of_sets_is_one_calibration_whatever_holds_them(simulated, tmp_path):
    simulated.save(tmp_path)
    found = bs.calibrate([simulated.telemetry, tmp_path / "validation.csv"], simulated.sensor, progress=False)
    assert [one.name for one in found.inputs.passes] == ["set 1", "validation.csv"]
    assert list(found.inputs.sha256s) == ["telemetry_2"]
    with pytest.raises(bs.RefusedInputError, match="set 1", check=has_code("same-centroids")):
        bs.calibrate([simulated.telemetry, tmp_path / "calibration.csv"], simulated.sensor, progress=False)
    with pytest.raises(bs.RefusedInputError, check=has_code("no-telemetry")):
        bs.calibrate([], simulated.sensor)


def test_help_shows_every_setting():
    assert all(
        f"{name}=" in str(bs.calibrate.__signature__) and f"\n{name}\n" in bs.calibrate.__doc__ for name in OPTIONS
    )


def test_progress_is_told_to_a_function(simulated):
    told = []
    bs.calibrate(simulated.telemetry, simulated.sensor, progress=lambda message, _: told.append(message))
    assert "loading the star catalogue" in told


def test_a_notebook_without_widgets_shows_a_line_and_a_script_nothing(simulated, capsys, monkeypatch):
    monkeypatch.setattr("boresight.library.progress.PATIENCE_S", 0.0)
    bs.check(simulated.telemetry, simulated.sensor)
    assert capsys.readouterr().err == ""
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    bs.check(simulated.telemetry, simulated.sensor)
    assert capsys.readouterr().err.startswith("boresight: ")


@pytest.mark.parametrize(
    ("wanted", "said"), [(False, []), (None, ["Boresight is compiling; this takes a few seconds."])]
)
def test_where_no_progress_is_wanted_not_even_compiling_is_told(wanted, said, simulated, caplog, monkeypatch):
    load = catalogue.load_catalogue

    def compile_and_load(*arguments):
        tell("compiling", 0.0)
        return load(*arguments)

    monkeypatch.setattr("boresight.sky.catalogue.load_catalogue", compile_and_load)
    bs.check(simulated.telemetry, simulated.sensor, progress=wanted)
    assert caplog.messages == said


def test_a_calibration_is_copied_with_what_it_can_do(cal):
    assert copy.deepcopy(cal) == cal
    assert dataclasses.replace(cal, advice=[]).figures == cal.figures


def test_files_are_named_by_their_bytes_and_tables_are_not(simulated, cal, tmp_path):
    simulated.save(tmp_path)
    found = bs.calibrate(tmp_path / "calibration.csv", tmp_path / "sensor.json", progress=False)
    assert set(found.inputs.sha256s) == {"telemetry", "sensor"}
    assert cal.inputs.sha256s == {}


def test_check_finds_what_is_there(simulated):
    quality = bs.check(simulated.telemetry, simulated.sensor)
    assert (quality.frames, quality.stars) == (30, len(simulated.telemetry))
    assert quality.verdict == quality.to_dict()["verdict"]
    assert all(finding.sentence for finding in quality.findings)


def test_match_names_the_stars_whose_names_are_missing(simulated, cal, tmp_path):
    found = bs.match(simulated.telemetry, simulated.sensor, parameters=cal)
    assert found.added > 0
    assert int(np.count_nonzero(found.telemetry.star_id)) == found.matched
    found.save(tmp_path / "matched.csv")
    assert len(bs.read_telemetry(tmp_path / "matched.csv")) == len(found.to_frame())


def test_evaluate_compares_with_the_sensor_or_with_what_is_given(simulated, cal):
    found = bs.evaluate(simulated.validation, simulated.sensor, cal, shadow=True)
    assert found.rms_arc_rad.final < found.rms_arc_rad.initial
    assert found.shadow.frames_in_set == found.frames
    assert found.to_dict()["rms_arc_rad"]["final"] == found.rms_arc_rad.final
    same = bs.evaluate(simulated.validation, simulated.sensor, cal, against=cal.parameters)
    assert same.rms_arc_rad.final == same.rms_arc_rad.initial
    assert same.shadow is None


def test_assess_answers_every_gate(simulated, cal):
    found = bs.assess(cal, simulated.sensor)
    assert found.verdict in {"PASS", "MARGINAL", "NO-DATA", "FAIL"}
    assert {gate.name: gate.status for gate in found.gates} == {
        one["name"]: one["status"] for one in found.to_dict()["gates"]
    }
    assert bs.assess(cal.to_dict(), simulated.sensor, validate=simulated.validation).sensor == simulated.sensor.name


def test_choose_names_a_camera(simulated):
    found = bs.choose(simulated.telemetry, simulated.sensor, validate=simulated.validation)
    assert found.sentence
    assert found.chosen.camera_model


def test_a_simulation_repeats_by_its_seed(simulated):
    again = bs.simulate("st16-1", frames=30)
    assert np.array_equal(again.telemetry.row_px, simulated.telemetry.row_px)
    other = bs.simulate({"sensor": 1, "frames": 5}, seed=7)
    assert len(np.unique(other.telemetry.frame)) == 5


def test_what_cannot_be_written_or_changed_is_refused_in_a_sentence(cal, tmp_path):
    for save in (cal.save, cal.report):
        with pytest.raises(bs.BoresightError, check=has_code("unwritable")):
            save(tmp_path / "none" / "cal.json")
    with pytest.raises(AttributeError, match="read-only"):
        cal.parameters.f_m = 3.0


def test_a_row_of_the_frame_divides_its_change_by_the_sigma_that_the_summary_shows(cal):
    frame = cal.to_frame("polars")
    ratio = dict(zip(frame["parameter"], frame["change"] / frame["sigma_with_misfit"], strict=True))
    told = dict(zip(frame["parameter"], frame["change_over_sigma"], strict=True))
    assert {name: told[name] for name in cal.free} == pytest.approx({name: ratio[name] for name in cal.free})
