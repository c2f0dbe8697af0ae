"""The calibration JSON: what is written is read back, the published schema describes it, and what is none is refused by path."""

import json
from copy import deepcopy
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from boresight.calibration.calibration import (
    compute_json_schema,
    parse_calibration,
    parse_foreign_calibration,
    read_calibration,
)
from boresight.calibration.options import METHODS
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.figures import FIGURES
from boresight.figures.chart import Trace
from boresight.figures.example_calibration import get_example_calibrations
from tests.console.operations import OPENAPI
from tests.refusals import has_code

PUBLISHED = Path(__file__).resolve().parents[2] / "docs" / "calibration.schema.json"
VALIDATOR = Draft202012Validator(json.loads(PUBLISHED.read_text()))
EXAMPLES = get_example_calibrations()
#: Files as earlier versions wrote them, their longest lists cut short.
EARLIER = json.loads((Path(__file__).parent / "earlier_calibrations.json").read_text())
#: Members that the first version of the schema had not.
NEWER = (
    "alignment", "coverage", "delta_over_sigma", "evaluation", "frame_observability", "frames_in_set", "judged_on", "matching",
    "robust", "shadow", "symbols", "timing_s", "trust", "variant",
)  # fmt: skip


def find_places(document, path=()):
    """Yield the path of every member and entry."""
    entries = (
        document.items() if isinstance(document, dict) else enumerate(document) if isinstance(document, list) else ()
    )
    for key, value in entries:
        yield (*path, key)
        yield from find_places(value, (*path, key))


def holds(whole, part):
    """Whether every member of the part stands in the whole, as it is."""
    if isinstance(part, dict):
        return all(key in whole and holds(whole[key], value) for key, value in part.items())
    return whole == part


def replaced(document, path, value):
    """Return the document with another value at one place."""
    made = deepcopy(document)
    place = made
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return made


BATCH = json.loads(EXAMPLES["batch"].to_json())
#: Without its longest parts, which are alike.
SHORT = {
    name: said
    for name, said in BATCH.items()
    if name not in {"coverage", "frame_observability", "history", "shadow", "trace", "trust"}
}
PLACES = list(find_places(SHORT))
OTHERS = st.one_of(
    st.none(), st.booleans(), st.integers(-9, 9), st.floats(-1e6, 1e6), st.text("ab", max_size=3),
    st.just([]), st.just({}), st.just([1.0, None]), st.just({"f_m": 1.0}),
)  # fmt: skip


def test_the_published_schema_is_that_of_the_types_and_a_schema():
    assert json.loads(PUBLISHED.read_text()) == compute_json_schema()
    Draft202012Validator.check_schema(compute_json_schema())


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_stored_example_keeps_the_schema_and_comes_back_the_same(name):
    document = json.loads(EXAMPLES[name].to_json())
    assert [error.json_path for error in VALIDATOR.iter_errors(document)] == []
    once = parse_calibration(document)
    assert parse_calibration(once.to_json()) == once
    assert holds(once.to_dict(), document)


@pytest.mark.few(3)
@pytest.mark.parametrize("method", METHODS)
def test_a_result_of_every_method_keeps_the_schema_and_comes_back_the_same(
    calibrated, make_telemetry, tmp_path, method
):
    document = calibrated(make_telemetry(1, frames=12), method=method, match="given")
    assert [error.json_path for error in VALIDATOR.iter_errors(document)] == []
    parse_calibration(document).save(tmp_path / "found.json")
    assert json.loads((tmp_path / "found.json").read_text()) == document
    assert read_calibration(tmp_path / "found.json") == parse_calibration(document)


@pytest.mark.parametrize("model", CAMERA_MODELS)
def test_parameters_of_every_camera_model_are_read_by_name(model):
    names = CAMERA_MODELS[model].parameter_names
    values = {name: float(high) for name, (_, high) in zip(names, CAMERA_MODELS[model].plausible, strict=True)}
    of_this_camera = {
        "camera_model": model, "parameter_names": list(names), "parameters": values, "sigma": dict.fromkeys(names), "free": [],
        "typical_sigma": {}, "covariance": {"names": [], "matrix": []}, "sigma_with_misfit": {}, "misfit": None,
    }  # fmt: skip
    found = parse_calibration(BATCH | of_this_camera)
    assert [getattr(found.parameters, name) for name in names] == list(values.values())
    assert found.sigma.to_dict() == dict.fromkeys(names)


#: Members whose numbers have to be those of a camera too, which a schema cannot say.
OF_THE_CAMERA = {
    "camera_model", "parameter_names", "free", "parameters", "sigma", "sigma_with_misfit", "typical_sigma", "covariance", "misfit",
    "frames", "exposures", "stars", "pairs", "iterations", "status",
}  # fmt: skip


@given(path=st.sampled_from(PLACES), value=OTHERS)
def test_what_the_schema_allows_is_read_and_what_is_refused_names_its_place(path, value):
    document = replaced(SHORT, path, value)
    fault = find_fault(document)
    if VALIDATOR.is_valid(document) and (fault is None or path[0] not in OF_THE_CAMERA):
        found = parse_calibration(document)
        assert parse_calibration(found.to_json()).to_json() == found.to_json()
    else:
        assert fault is not None
        assert path[0] == "status" or any(f"({key!s}" in fault or f".{key}" in fault for key in path)


def find_fault(document):
    """Return what a refusal says; None where there is none."""
    try:
        parse_foreign_calibration(document)
    except RefusedInputError as refused:
        return str(refused)
    return None


def test_a_file_of_the_first_version_loads_without_what_came_later():
    old = {key: value for key, value in BATCH.items() if key not in NEWER}
    found = parse_calibration(json.dumps(old))
    assert found.parameters.to_dict() == BATCH["parameters"]
    assert (found.trust, found.matching, found.robust, found.shadow.validation) == (None, None, None, None)


@pytest.mark.parametrize("name", EARLIER)
def test_a_file_that_an_earlier_version_wrote_loads_and_is_drawn(name):
    found = parse_calibration(json.dumps(EARLIER[name]))
    assert found.parameters.to_dict() == EARLIER[name]["parameters"]
    assert parse_calibration(found.to_json()) == found
    for figure in FIGURES.values():
        assert figure.draw([Trace("earlier", found)]).layout.title.text
        figure.table(found)


def test_outliers_of_an_earlier_version_are_drawn_on_the_whole_detector():
    found = parse_calibration(EARLIER["without the size of the detector"])
    assert found.trust.residual_outliers.rows is None
    layout = FIGURES["residual-outliers"].draw([Trace("earlier", found)]).layout
    edges = found.trust.residual_field
    assert layout.xaxis.range == (-0.5, edges.col_edges_px[-1])
    assert layout.yaxis.range == (edges.row_edges_px[-1], -0.5)


def test_members_of_a_later_version_are_passed_over():
    assert parse_calibration(BATCH | {"moonlight": {"share": 0.1}}) == parse_calibration(BATCH)


WRONG_LENGTHS = (float("nan"), "1", True, -0.03, None)
TWO = {"names": ["f_m", "g_y"]}


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"parameters": {"f_m": "long"}}, "parameters.f_m"),
        ({"chi2": {"dof": 3}}, "chi2.lower"),
        ({"covariance": {"names": ["f_m"], "matrix": [["a"]]}}, "covariance.matrix.0.0"),
        ({"status": "fine"}, "status"),
        ({"schema": "boresight.calibration/2"}, "schema"),
        ({"sigma": None}, "sigma"),
        ({"frames": "5"}, "frames"),
        ({"frames": -5}, "frames"),
        ({"frames": True}, "frames"),
        ({"frames": 5.5}, "frames"),
        ({"camera_model": "bogus"}, "camera_model"),
        ({"parameter_names": ["a"]}, "parameter_names"),
        ({"parameters": {}}, "parameters.f_m"),
        *(({"parameters": BATCH["parameters"] | {"f_m": wrong}}, "parameters.f_m") for wrong in WRONG_LENGTHS),
        ({"parameters": BATCH["parameters"] | {"k1": 0.0}}, "parameters.k1"),
        ({"sigma": BATCH["sigma"] | {"f_m": -1.0}}, "sigma.f_m"),
        ({"sigma": BATCH["sigma"] | {"k1": 1.0}}, "sigma.k1"),
        ({"covariance": TWO | {"matrix": [[1.0]]}}, "covariance.matrix"),
        ({"covariance": TWO | {"matrix": [[1.0, 2.0], [3.0]]}}, "covariance.matrix"),
        ({"covariance": TWO | {"matrix": [[1.0, 0.5], [0.4, 1.0]]}}, "covariance.matrix.1.0"),
        ({"covariance": TWO | {"matrix": [[1.0, 0.5], [0.5, -1.0]]}}, "covariance.matrix.1.1"),
        ({"covariance": {"names": ["f_m", "f_m"], "matrix": [[1.0, 1.0], [1.0, 1.0]]}}, "covariance.names"),
    ],
)
def test_what_is_no_calibration_is_refused_by_the_path_of_its_fault(change, place):
    with pytest.raises(RefusedInputError, check=has_code("incomplete-calibration")) as refused:
        parse_foreign_calibration(BATCH | change, "cal.json")
    assert f"({place}:" in str(refused.value)


def test_a_calibration_on_its_way_or_that_failed_need_not_know_its_parameters():
    for status in ("running", "diverged"):
        unknown = dict.fromkeys(BATCH["parameters"])
        assert parse_calibration(BATCH | {"status": status, "parameters": unknown}).parameters.f_m is None


def test_a_whole_number_may_be_written_with_a_point():
    frames = parse_calibration(BATCH | {"frames": 5.0}).frames
    assert (frames, type(frames)) == (5, int)


def test_text_that_is_no_json_is_refused_with_line_and_column():
    with pytest.raises(RefusedInputError, match="column 12"):
        parse_calibration('{"schema": oops}', "cal.json")


def test_rest_describes_the_result_of_a_run_by_the_same_tree():
    answer = OPENAPI["paths"]["/api/v1/runs/{run_id}/result"]["get"]["responses"]["200"]["content"]["application/json"]
    assert {"$ref": "#/components/schemas/Calibration"} in answer["schema"]["anyOf"]
    said = set(OPENAPI["components"]["schemas"]["Calibration"]["properties"])
    assert said == set(compute_json_schema()["properties"])
