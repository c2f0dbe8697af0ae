"""Made-up requests over every operation, as administrator, analyst and anonymous; `make fuzz` sends more."""

from __future__ import annotations

import random
from contextlib import closing

import pytest

from boresight.sky.catalogue import load_catalogue
from tests.fuzz.documents import KINDS, ODD, changed, places
from tests.fuzz.run import fuzz
from tests.fuzz.world import furnished
from tests.served import house_in

REQUESTS = 3000


@pytest.mark.full
def test_no_request_ends_in_a_server_error_or_in_an_answer_that_is_not_documented(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    folder = tmp_path_factory.mktemp("fuzz")
    with house_in(folder, load_catalogue(folder / "catalogue")) as house, closing(furnished(house)) as world:
        tally = fuzz(world, REQUESTS, seed=1)
    assert tally.failures == []
    assert tally.requests >= 0.9 * REQUESTS
    assert len(tally.operations) == len(world.operations)
    assert set(tally.by_asker) == {"adele", "ada", "anonymous"}
    assert tally.by_kind["documents"] > REQUESTS / 10
    assert tally.statuses[200] > REQUESTS / 10  # many are understood, and not only turned away at the first look
    assert max(asker.log_ins for asker in world.askers) < REQUESTS / 10


def test_the_kinds_of_documents_are_operations_that_there_are() -> None:
    assert {"register_sensor", "set_gate_profile", "set_table_definition", "launch_run", "upload_telemetry_set"} <= {
        kind.operation for kind in KINDS
    }


def test_a_changed_document_is_another_one_and_the_good_one_stays() -> None:
    good = {"a": [1, {"b": "c"}], "d": 2.5}
    others = [changed(good, random.Random(seed)) for seed in range(50)]
    assert good == {"a": [1, {"b": "c"}], "d": 2.5}
    assert sum(other != good for other in others) > 45
    assert len(list(places(good))) == 6
    assert len(ODD) > 40
