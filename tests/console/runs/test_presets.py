"""Presets: settings under a name with a sentence, versioned, archived, on record; Boresight's own are all usable."""

import pytest

from boresight.calibration.options import CalibrationSettings
from boresight.console.runs import presets
from boresight.console.runs.presets import BUILT_IN
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_writing

WHEN = "On Mondays."


@pytest.fixture
def session(engine, people):  # noqa: ARG001 - people are made in a transaction of their own, before this one begins
    with open_writing(engine) as session:
        yield session


@pytest.fixture
def save(session, people):
    def save(name="Ours", sentence=WHEN, actor="ana", **settings):
        return presets.save_preset(session, people[actor], name, sentence, settings)

    return save


@pytest.mark.parametrize("offer", BUILT_IN, ids=lambda offer: offer.key)
def test_every_preset_of_boresight_has_whole_settings_and_one_sentence_on_when_to_use_it(offer):
    assert CalibrationSettings.parse(offer.settings).document() == offer.settings
    assert offer.sentence.endswith(".")
    assert offer.sentence.count(". ") <= 1
    assert len(offer.sentence) > 30


def test_boresights_presets_differ_in_key_name_and_settings():
    for name in ("key", "name", "sentence"):
        assert len({getattr(offer, name) for offer in BUILT_IN}) == len(BUILT_IN)
    assert len({str(offer.settings) for offer in BUILT_IN}) == len(BUILT_IN)


def test_a_saved_preset_is_offered_with_every_setting_written_out(session, save):
    row = save(method="sqrf", variant="q")
    offer = presets.list_offers(session)[-1]
    assert (offer.key, offer.name, offer.sentence) == (str(row.id), "Ours, version 1", WHEN)
    assert (offer.settings["method"], offer.settings["linearisations"]) == ("sqrf", 6)
    assert presets.get_offer(session, offer.key) == offer
    record = audit.last_change(session, f"presets/{row.id}")
    assert (record.action, record.after["settings"]) == ("saved", offer.settings)


def test_saving_under_the_same_name_makes_the_next_version_and_leaves_the_first_as_it_was(session, save):
    first, second = save(), save(robust="huber")
    assert (first.number, second.number) == (1, 2)
    assert [offer.key for offer in presets.list_offers(session) if offer not in BUILT_IN] == [str(second.id)]
    assert presets.get_offer(session, str(first.id)).settings["robust"] == "none"


def test_what_an_archived_version_said_can_still_be_read_and_an_older_one_comes_forward(session, people, save):
    first, second = save(), save(robust="huber")
    presets.archive_preset(session, people["ana"], second.id)
    presets.archive_preset(session, people["ana"], second.id)
    assert presets.list_offers(session)[-1].key == str(first.id)
    assert presets.get_offer(session, str(second.id)).settings["robust"] == "huber"
    assert [row.id for row in presets.list_presets(session)] == [first.id]
    assert [row.id for row in presets.list_presets(session, archived=True)] == [second.id, first.id]
    assert audit.last_change(session, f"presets/{second.id}").action == "archived"


def test_the_same_again_is_no_new_version_unless_it_was_archived(session, people, save):
    row = save()
    with pytest.raises(ConflictError, match="Version 1 of Ours says the same already"):
        save()
    presets.archive_preset(session, people["ana"], row.id)
    assert save().number == 2


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"name": " "}, "Give the preset a name"),
        ({"name": "n" * 61}, "up to 60 characters"),
        ({"sentence": ""}, "when to use Ours"),
        ({"name": "quick LOOK"}, "comes with Boresight; choose another name"),
        ({"name": "a\x07b"}, "U.0007"),
        ({"method": "magic"}, "choose from batch"),
    ],
)
def test_a_preset_that_would_not_do_is_refused(save, given, said):
    with pytest.raises(RefusedInputError, match=said):
        save(**given)


def test_only_an_analyst_saves_and_archives(session, people, save):
    row = save()
    for name in ("eve", "cy", "dee", "root"):
        with pytest.raises(ForbiddenError, match="needs the role analyst"):
            save(actor=name)
        with pytest.raises(ForbiddenError, match="needs the role analyst"):
            presets.archive_preset(session, people[name], row.id)


@pytest.mark.parametrize("key", ["99", "no-such", "-1", "9" * 30])
def test_a_preset_that_there_is_not_is_said_to_be_so(session, key):
    with pytest.raises(NotFoundError, match="There is no preset"):
        presets.get_offer(session, key)


def test_settings_given_beside_a_preset_go_over_its_own(session):
    name, settings = presets.chosen_settings(session, "drift-tracking", {"process_noise_sigma": 0.1})
    assert name == "Drift tracking"
    assert (settings["variant"], settings["process_noise_sigma"]) == ("q", 0.1)
    assert presets.chosen_settings(session, None, {"method": "ekf"}) == (None, {"method": "ekf"})
