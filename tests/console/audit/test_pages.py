"""The audit log as a page."""

import pytest

from boresight.console.audit.pages import changes, make_audit_line
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading, open_writing
from tests.stores import drop_triggers


def test_the_light_says_whether_the_chain_holds(site, read):
    visitor = site.visitor("victor")
    assert "CHAIN HOLDS" in read(visitor.get("/audit"))
    with site.engine.begin() as connection:
        drop_triggers(connection)
        connection.exec_driver_sql("UPDATE audit SET reason = 'altered' WHERE id = 2")
    page = read(visitor.get("/audit"))
    assert "CHAIN BROKEN" in page
    assert "Record 2 is not as it was written" in page


def test_a_long_chain_is_verified_when_asked(site, read, monkeypatch):
    monkeypatch.setattr("boresight.console.audit.pages.VERIFIED_AT_EVERY_VISIT", 1)
    visitor = site.visitor("victor")
    assert "NOT VERIFIED" in read(visitor.get("/audit"))
    assert "CHAIN HOLDS" in read(visitor.get("/audit?verify=1"))


def test_records_of_one_object_are_found_by_its_address(site, read):
    page = read(site.visitor("victor").get("/audit?object=users/2"))
    assert "users/2" in page
    assert "users/3" not in page
    assert 'class="empty"' in site.visitor("victor").get("/audit?object=runs/99")


def test_older_records_follow_where_the_page_ended(site):
    with open_writing(site.engine) as session:
        for number in range(60):
            audit.append(session, site.actor("ada"), f"did-{number}", "runs/1")
    page = site.visitor("victor").get("/audit?object=runs/1")
    assert "did-59" in page
    assert ">did-9<span" not in page
    address = page.split("Older records")[0].rsplit('href="', 1)[1].split('"')[0].replace("&amp;", "&")
    assert ">did-9<span" in site.visitor("victor").get(address)


def test_filters_in_the_address_narrow_the_list_and_stay_in_the_form(site, read):
    with open_writing(site.engine) as session:
        audit.append(session, site.actor("ada"), "tested", "runs/1", None, {"state": "x"}, "why")
        audit.append(session, site.actor("olga"), "tested", "runs/2")
    visitor = site.visitor("victor")
    page = read(visitor.get("/audit?action=tested&actor=Ada+Analyst"))
    assert "runs/1" in page
    assert "runs/2" not in page
    assert "<option selected>tested</option>" in visitor.get("/audit?action=tested")
    assert 'class="empty"' in visitor.get("/audit?since=2100-01-01")
    assert "runs/2" in read(visitor.get("/audit?since=2020-01-01T00:00Z&until=2100-01-01&action=tested"))
    assert "'soon' is no time" in read(visitor.get("/audit?since=soon"))


def test_a_record_is_shown_whole_with_names_and_units(site, read):
    before, after = {"initial": {"f_m": 0.016}, "version": 1}, {"initial": {"f_m": 0.0161}, "version": 2}
    with open_writing(site.engine) as session:
        record = audit.append(session, site.actor("ada"), "edited", "sensors/1", before, after, "focus moved")
    page = read(site.visitor("victor").get(f"/audit/{record.id}"))
    for said in ("Initial, f", "mm", "16.1", "focus moved", "Roles then analyst", "Rows sealed none by this record"):
        assert said in page, said
    assert site.visitor("victor").send("GET", "/audit/99999", headers={"accept": "text/html"}).status_code == 404


def test_the_bar_tells_through_which_record_the_chain_was_verified(site):
    visitor = site.visitor("victor")
    assert "NOT YET" in visitor.get("/sensors").split("<main")[0]
    site.app.state.upkeep.verify()
    with open_reading(site.engine) as session:
        last = audit.list_records(session, limit=1)[0].id
    assert f"#{last} " in visitor.get("/sensors").split("<main")[0]
    with site.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE users SET roles = '[]' WHERE id = 1")
    site.app.state.upkeep.verify()
    assert "BROKEN" in visitor.get("/sensors").split("<main")[0]


def test_only_what_differs_is_shown_and_nested_members_by_their_path():
    found = changes({"a": 1, "b": {"c": 2.0, "d": "x"}}, {"a": 1, "b": {"c": 2.5, "d": "x"}, "e": ["p", "q"]})
    assert [(it.name, it.before, it.after) for it in found] == [("b.c", "2", "2.5"), ("e", "–", "p, q")]


def test_a_removed_member_and_a_hash_are_shown_short():
    assert [(it.name, it.after) for it in changes({"gone": 1}, {"sha256": "ab" * 32})] == [
        ("sha256", "abababab"),
        ("gone", "–"),
    ]


@pytest.mark.parametrize(
    ("subject", "address"),
    [
        ("parameter-sets/3", "/parameter-sets/3"),
        ("telemetry-sets/7", "/telemetry/7"),
        ("users/1", None),
        ("runs/x", None),
    ],
)
def test_a_record_leads_to_the_page_of_its_object(site, subject, address):
    with open_writing(site.engine) as session:
        record = audit.append(session, site.actor("ada"), "did", subject)
        assert make_audit_line(record).address == address


def test_what_people_wrote_is_never_markup(site):
    with open_writing(site.engine) as session:
        audit.append(session, site.actor("ada"), "did", "runs/1", None, {"label": "<i>x</i>"}, "<script>")
    page = site.visitor("victor").get("/audit")
    assert "&lt;i&gt;x&lt;/i&gt;" in page
    assert ">&lt;script&gt;</td>" in page


def test_the_log_is_not_for_strangers(site):
    visitor = site.visitor("ada")
    visitor.cookies.clear()
    assert visitor.send("GET", "/audit").status_code in {303, 401}
    with open_reading(site.engine) as session:
        assert audit.verify(session).ok
