"""A new installation: every page says what to do next."""

import dataclasses

import pytest

from boresight.platform.db.sessions import migrate, open_writing
from tests.passwords import add_person
from tests.stores import url_in


@pytest.fixture
def bare(site, tmp_path):
    folder = tmp_path / "bare"
    settings = dataclasses.replace(site.settings, data_folder=folder, database_url=url_in(folder))
    bare = type(site)(settings)
    migrate(bare.engine)
    with open_writing(bare.engine) as session:
        roles = ["analyst", "operator", "administrator"]
        add_person(session, "ada", *roles, printed_name="Ada Analyst")
    bare.app.state.workers = None
    yield bare
    bare.engine.dispose()


@pytest.mark.parametrize(
    ("path", "sentences"),
    [
        ("/", ["No sensors yet.", "Register a sensor"]),
        ("/sensors", ["No sensors yet.", "Begin with the example"]),
        ("/telemetry", ["No telemetry yet.", "Register the sensor first"]),
        ("/users", ["No API keys."]),
        ("/runs", ["No runs yet."]),
        ("/approvals", []),
        ("/parameter-sets", []),
        ("/audit", ["CHAIN HOLDS"]),
    ],
)
def test_an_empty_page_says_what_to_do_next(bare, read, path, sentences):
    page = bare.visitor("ada").get(path)
    for sentence in sentences:
        assert sentence in read(page)
    assert "NO SENSORS" in page.split("<main")[0]


def test_a_filter_that_nothing_fits_is_another_sentence_than_an_empty_store(bare):
    assert 'class="empty"' in bare.visitor("ada").get("/telemetry?purpose=validation")
