"""Preferences: each person's own, kept under known names; above all how times are shown, and that they are taken as shown."""

import html
import re
from datetime import datetime
from urllib.parse import quote
from uuid import UUID

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from boresight.console.access import preferences, users
from boresight.console.access.queries import write_preference
from boresight.console.pages.formats import STORED_TIME, show_times
from boresight.console.pages.rendering import TEMPLATES
from boresight.errors import ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing, utc_after
from boresight.platform.db.times import STYLE, TIME_FORMS, TimeStyle, read_time
from boresight.verdicts.numbers import Typed, show_numbers
from tests.console.alarms.test_pages import drifting  # noqa: F401 - a fixture
from tests.console.approvals.test_pages import signed, submitted
from tests.sites import PASSWORD, PEOPLE

ZONE = "Asia/Kathmandu"
PAGES = (
    "/",
    "/sensors/1",
    "/sensors/1/timeline",
    "/telemetry",
    "/runs",
    "/runs/1?part=record",
    "/parameter-sets",
    "/audit",
    "/users",
)
MOMENT = re.compile(r"<time[^>]*datetime=\"([^\"]+)\"[^>]*title=\"([^\"]+)\"[^>]*>([^<]+)</time>")


def _moment(stored):
    return datetime.fromisoformat(stored)


def _choose(site, name, form):
    answer = site.visitor(name).post("/preferences", form=form, zone=ZONE)
    assert answer.status_code == 303, answer.text


@pytest.mark.parametrize("form", TIME_FORMS)
def test_every_page_shows_its_times_in_the_chosen_form(site, form):
    _choose(site, "adele", form)
    style, seen = TimeStyle(form, ZONE), 0
    for path in PAGES:
        page = site.visitor("adele").get(path)
        assert f'data-times="{form}"' in page
        for stored, title, shown in MOMENT.findall(page):
            seen += 1
            exact = read_time(stored)[:19]
            assert read_time(html.unescape(title))[:19] == exact
            if "ago" not in shown and shown != "just now":
                assert html.unescape(shown) == style.show(_moment(stored)), path
    assert seen > 30


@pytest.mark.parametrize("form", TIME_FORMS)
@pytest.mark.usefixtures("drifting")
def test_every_field_for_a_time_takes_what_is_shown(site, form):
    style = TimeStyle(form, ZONE)
    _choose(site, "ada", "iso")  # whichever is chosen
    ada = site.visitor("ada")
    later = quote(style.show(_moment(utc_after(3600))))
    assert not MOMENT.findall(ada.get(f"/audit?since={later}"))
    assert len(MOMENT.findall(ada.get(f"/audit?until={later}"))) > 5
    for path in ("/sensors/1", "/sensors/1/timeline"):
        assert "PS-" in ada.get(f"{path}?at={later}")
    for operation in ("sensors/1/history", "sensors/1/timeline"):
        name = "until" if operation.endswith("timeline") else "at"
        assert ada.send("GET", f"/api/v1/{operation}?{name}={later}").status_code == 200
    page = ada.get("/alarms/1")
    version = page.split('name="version" value="')[1].split('"')[0]
    until = style.show(_moment(utc_after(7200)))
    assert ada.post("/alarms/1/shelve", version=version, until=until, text="A pass comes.").status_code == 303
    assert TimeStyle("iso").show(_moment(read_time(until))) in ada.get("/alarms/1")


@pytest.mark.parametrize("form", TIME_FORMS)
@pytest.mark.usefixtures("drifting")
def test_times_in_sentences_that_the_store_has_are_shown_in_the_chosen_form(site, form):
    style, until = TimeStyle(form, ZONE), utc_after(7200)
    for name in ("ada", "both"):
        _choose(site, name, form)
    ada, both = site.visitor("ada"), site.visitor("both")
    version = ada.get("/alarms/1").split('name="version" value="')[1].split('"')[0]
    ada.post("/alarms/1/shelve", version=version, until=until, text="<b>2026-11-21T03:04:05Z</b>")
    request = submitted(site, "ada", 1)
    signed(site.visitor("alan"), request)
    for path in ("/alarms", "/alarms/1"):
        page = ada.get(path)
        assert f"shelved until {style.show(_moment(until))}" in html.unescape(page)
    shown = style.show(_moment("2026-11-21T03:04:05Z"))
    assert f"&lt;b&gt;{shown}&lt;/b&gt;" in page  # and nothing that was escaped is markup now
    refused = both.post(f"{request}/sign", version="77", password=PASSWORD, decision="REFUSE", comment="No.")
    at = re.search(r"approved it at (.+?)\. Reload", html.unescape(refused.text))[1]
    assert style.show(_moment(read_time(at))) == at
    for text in (refused.text, both.get(request), ada.get("/parameter-sets"), ada.get("/audit")):
        outside = re.sub(r"<(pre|textarea|script|code)\b.*?</\1>|<[^>]*>", " ", text, flags=re.DOTALL)
        assert STORED_TIME.findall(outside) == []


def test_fields_documents_and_attributes_that_are_not_read_keep_a_time():
    stored, style = "2026-11-21T03:04:05.600000Z", TimeStyle("iso")
    kept = f'<i data-value="{stored}"><input value="at {stored}"><pre>{stored}</pre><code>{stored}</code></i>'
    assert show_times(kept, style) == kept
    told = f'<p title="at {stored}" aria-label="{stored}">at {stored}, {stored} and 2026-13-45T99:99:99Z</p>'
    assert show_times(told, style) == told.replace(stored, "2026-11-21 03:04:05Z")


def test_numbers_in_sentences_are_written_as_in_tables_and_what_people_wrote_or_copy_is_kept():
    told = "<p>g is -0.28 (-0.5, +1) of 1,200 exposures, 29% off; p &lt; 6.6e-24, 85.3 urad on PS-ST16-4-1 of 2026-11-28, f,b2</p>"
    thin, minus = "\u202f", "\u2212"
    assert show_numbers(told) == (
        f"<p>g is {minus}0.28 ({minus}0.5, +1) of 1{thin}200 exposures, 29{thin}% off; p &lt; 6.6·10⁻²⁴, 85.3 µrad on PS-ST16-4-1 "
        "of 2026-11-28, f,b2</p>"
    )
    kept = (
        '<i data-at="-1,200"><code>-1,200</code><q>5% of 1,200</q><input value="-5%"><svg><path d="M-1,200"/></svg></i>'
    )
    assert show_numbers(kept) == kept
    read_out = '<i title="by 1,753.4, -0.54 g_y" aria-label="at -5%" data-at="-1,200"><b title="-1">-1</b></i>'
    assert show_numbers(read_out) == (
        f'<i title="by 1{thin}753.4, {minus}0.54 g_y" '
        f'aria-label="at {minus}5{thin}%" data-at="-1,200"><b title="{minus}1">{minus}1</b></i>'
    )
    assert show_numbers("<p>from -1.2e-05 to 3e+10</p>") == f"<p>from {minus}1.2·10⁻⁵ to 3·10¹⁰</p>"


def test_what_a_person_typed_keeps_its_numbers_wherever_a_page_prints_it():
    typed = Typed("flat 1,000 -5 of 5% at 3e-5, 12,345,678 urad.csv & 'q'-3")
    page = TEMPLATES.from_string('<b title="{{ name }}">{{ name }}</b> {{ name ~ "" }}').render(name=typed)
    kept, shown = show_numbers(page).split("</b>")
    assert html.unescape(kept) == f'<b title="{typed}">{typed}'
    assert "1\u202f000" in shown


@example("26d2f85e27011179f2e80f119e0552e3", UUID("26d2f85e-1e11-4179-92e8-0f119e0552e3"), "gap-")
@given(st.text("0123456789abcdef", min_size=7, max_size=64), st.uuids(), st.sampled_from(["", "gap-", "sha256:"]))
def test_no_checksum_or_identifier_in_a_sentence_is_taken_for_a_number(digest, uuid, before):
    page = f"<p>{before}{digest}, {uuid}, {str(uuid)[:8]}</p>"
    assert show_numbers(page) == page


def test_fields_are_filled_in_as_times_are_shown(site):
    _choose(site, "ada", "local")
    page = site.visitor("ada").get("/sensors/1")
    filled = html.unescape(re.search(r'id="at" name="at" value="([^"]+)"', page)[1])
    assert filled.endswith("+05:45)")
    assert "PS-" in site.visitor("ada").get(f"/sensors/1?at={quote(filled)}")


def test_people_of_the_same_roles_share_no_page_across_their_forms(site):
    with open_writing(site.engine) as session:
        users.change_roles(session, COMMAND_LINE, list(PEOPLE).index("victor") + 1, ["analyst"])
    _choose(site, "ada", "iso")
    for _ in range(2):
        assert 'data-times="iso"' in site.visitor("ada").get("/telemetry")
        assert 'data-times="day_of_year"' in site.visitor("victor").get("/telemetry")
    ada = site.visitor("ada")
    for form in TIME_FORMS:  # under one log-in, whose identity is remembered
        ada.post("/preferences", form=form, zone=ZONE)
        assert f'data-times="{form}"' in ada.get("/telemetry")


def test_a_zone_that_is_not_known_is_refused_and_nothing_is_kept(site):
    answer = site.visitor("ada").post("/preferences", form="local", zone="Mars/Utopia")
    assert answer.status_code == 422
    assert "Mars/Utopia" in answer.text
    assert 'data-times="day_of_year"' in site.visitor("ada").get("/preferences")


def test_preferences_are_of_people_and_under_known_names(site):
    ada, alan = site.actor("ada"), site.actor("alan")
    with open_writing(site.engine) as session:
        assert preferences.set_preference(session, ada, "times", {"form": "iso", "zone": ZONE}) == {
            "form": "iso",
            "zone": "UTC",
        }
        preferences.set_preference(session, ada, "times", {"form": "local", "zone": ZONE})
        with pytest.raises(NotFoundError):
            preferences.set_preference(session, ada, "colour", "red")
        with pytest.raises(ForbiddenError):
            preferences.set_preference(session, COMMAND_LINE, "times", {"form": "iso"})
        for value in ("iso", {"form": "julian"}, {"form": "local"}, {"form": ["iso"]}, None):
            with pytest.raises(RefusedInputError):
                preferences.set_preference(session, ada, "times", value)
    with open_reading(site.engine) as session:
        assert preferences.get_time_style(session, ada.user_id) == TimeStyle("local", ZONE)
        assert preferences.get_time_style(session, alan.user_id) == STYLE


def test_a_value_that_is_not_known_any_more_counts_as_not_chosen(site):
    with open_writing(site.engine) as session:
        write_preference(session, 1, "times", {"form": "julian"})
        write_preference(session, 1, "forgotten", 1)
    with open_reading(site.engine) as session:
        assert set(preferences.get_preferences(session, 1)) == set(preferences.PREFERENCES)
        assert preferences.get_time_style(session, 1) == STYLE
    assert 'data-times="day_of_year"' in site.visitor("ada").get("/")


def test_a_theme_is_told_to_the_browser_at_the_log_in_and_the_systems_by_telling_none(site):
    visitor = site.visitor("adele")
    answer = visitor.post("/preferences", form="iso", theme="contrast")
    assert "boresight-theme=contrast" in answer.headers["set-cookie"]
    with open_reading(site.engine) as session:
        (adele,) = (user for user in users.list_users(session) if user.name == "adele")
        assert preferences.get_preferences(session, adele.id)["theme"] == "contrast"
    back = visitor.post("/preferences", form="day_of_year", theme="system")
    assert 'boresight-theme=""; ' in back.headers["set-cookie"]
    assert visitor.post("/preferences", form="iso", theme="pink").status_code == 422


def test_what_only_looks_like_a_time_stays_as_it_was_written(site):
    odd = "9999-99-99T99:99:99Z"
    with open_writing(site.engine) as session:
        audit.append(session, COMMAND_LINE, "tried", "users", None, {"name": odd})
    for path in ("/audit", f"/audit?since={odd}", f"/sensors/1/timeline?at={odd}"):
        answer = site.visitor("adele").send("GET", path)
        assert answer.status_code in {200, 422}, path
        assert odd in answer.text, path
