"""Gate profiles: what may be edited, and that every refusal names the gate and the key."""

import copy
import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.verdicts.gates import DEFAULT_PROFILE, GATES, parse_profile
from boresight.verdicts.gates.profile import FLAGS

LIMITED = [gate for gate in GATES.values() if gate.direction != "met"]
CRITICAL = [name for name, gate in GATES.items() if gate.critical]


def refusal(**entry):
    with pytest.raises(RefusedInputError) as refused:
        parse_profile({"gates": [entry]})
    return str(refused.value)


def test_the_default_reads_back_as_itself_and_has_every_gate():
    assert parse_profile(DEFAULT_PROFILE).document() == DEFAULT_PROFILE == parse_profile({}).document()
    assert [entry["name"] for entry in DEFAULT_PROFILE["gates"]] == list(GATES)


def test_what_is_left_out_is_the_defaults():
    profile = parse_profile({"gates": [{"name": "coverage", "limit": 0.5}]})
    expected = copy.deepcopy(DEFAULT_PROFILE)
    expected["gates"][list(GATES).index("coverage")]["limit"] = 0.5
    assert profile.document() == expected


def test_two_spellings_of_a_number_are_one_profile():
    written = [repr(parse_profile({"gates": [{"name": "nis", "limit": limit}]}).document()) for limit in (3, 3.0)]
    assert written[0] == written[1]


@pytest.mark.parametrize("name", CRITICAL)
@pytest.mark.parametrize(
    ("key", "value"), [("waivable", True), ("observe_only", True), ("must_have_data", False), ("critical", False)]
)
def test_a_critical_gate_cannot_be_softened(name, key, value):
    assert name in refusal(name=name, **{key: value})


def test_no_other_gate_can_be_made_critical():
    assert "coverage: it is not critical" in refusal(name="coverage", critical=True)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"name": "coverage", "limit": 1.5}, "coverage: limit is 1.5; give a number from 0 to 1, or null"),
        ({"name": "coverage", "marginal": "much"}, "coverage: marginal is 'much'"),
        ({"name": "coverage", "limit": True}, "coverage: limit is True"),
        ({"name": "coverage", "limit": float("nan")}, "coverage: limit is nan"),
        ({"name": "chi-square", "limit": 0.5}, "chi-square: limit is 0.5; give a number from 1"),
        ({"name": "validation-rms", "limit": 2, "marginal": 3}, "validation-rms: marginal is 3 and the limit 2"),
        ({"name": "availability", "limit": 0.9, "marginal": 0.5}, "give a marginal of at least the limit"),
        ({"name": "finite", "limit": 1.0}, "finite: limit and marginal are null"),
        ({"name": "coverage", "direction": "below"}, "coverage: direction is 'below'; it is always 'above'"),
        ({"name": "coverage", "waivable": "yes"}, "coverage: waivable is 'yes'; give true or false"),
        ({"name": "coverage", "lowest": 3}, "Gate coverage has no key 'lowest'"),
        ({"name": "beauty"}, "There is no gate 'beauty'"),
        ({}, "There is no gate None"),
    ],
)
def test_a_wrong_entry_is_refused_with_its_gate_and_key(entry, words):
    assert words in refusal(**entry)


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({"gate": []}, "no key 'gate'"),
        ({"schema": "other", "gates": []}, "schema is 'other'"),
        ({"gates": {}}, "no list of objects"),
        ({"gates": ["coverage"]}, "no list of objects"),
        ({"gates": [{"name": "nis"}, {"name": "nis"}]}, "nis is given twice"),
    ],
)
def test_a_document_that_is_no_profile_is_refused(document, words):
    with pytest.raises(RefusedInputError, match=words):
        parse_profile(document)


@given(st.data())
def test_any_thresholds_in_range_and_order_are_taken_and_read_back(data):
    entries = []
    for gate in LIMITED:
        pair = sorted(data.draw(st.floats(gate.lowest, gate.highest)) for _ in range(2))
        limit, marginal = pair if gate.direction == "above" else reversed(pair)
        flags = {key: data.draw(st.booleans()) for key in set(FLAGS) - {"critical"}}
        given_limit = data.draw(st.sampled_from([limit, None]))
        entries.append({"name": gate.name, "limit": given_limit, "marginal": marginal, **flags})
    profile = parse_profile({"gates": entries})
    assert parse_profile(profile.document()) == profile
    kept = {threshold.name: threshold for threshold in profile.thresholds}
    assert all(
        getattr(kept[entry["name"]], key) == value
        for entry, key in itertools.product(entries, entries[0])
        for value in [entry[key]]
    )
