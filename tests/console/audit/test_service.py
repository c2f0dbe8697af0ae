"""The audit log: one chain whoever writes, and a change by hand is found where it was made."""

import hashlib
import io
import json
import re
import subprocess
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa
from hypothesis import given
from hypothesis import strategies as st

from boresight.console.audit.pages import changes, find_unit, make_audit_line, name_member
from boresight.errors import RefusedInputError
from boresight.platform.actors import SYSTEM, Policy
from boresight.platform.audit import chain
from boresight.platform.audit import log as audit
from boresight.platform.audit.audit_verifier import canonical, compute_hash, verify
from boresight.platform.audit.export import FORMS, verifier, write_export
from boresight.platform.audit.tables import AuditRecord
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from tests.sites import codes
from tests.stores import drop_triggers, triggers_aside


@pytest.fixture
def log(engine) -> Engine:
    with open_writing(engine) as session:
        for number in range(10):
            audit.append(session, SYSTEM, "counted", f"numbers/{number}", None, {"ψ": number / 7}, "because")
    return engine


def _by_hand(engine: Engine, statement: str) -> None:
    with open_writing(engine) as session:
        connection = session.connection()
        with triggers_aside(connection):
            connection.exec_driver_sql(statement)


def _verify(engine: Engine, head: str | None = None) -> audit.ChainReport:
    with open_reading(engine) as session:
        return audit.verify(session, head)


def _count(session: Session) -> int:
    return session.scalar(sa.select(sa.func.count()).select_from(AuditRecord)) or 0


def test_an_untouched_chain_verifies_and_counts(log):
    with open_reading(log) as session:
        count, head = _count(session), audit.head(session)
    report = _verify(log)
    assert (report.ok, report.records, report.head, report.first_broken_id) == (True, count, head, None)


@pytest.mark.parametrize(
    ("changes", "broken_id"),
    [
        *(
            ([f"UPDATE audit SET {change} WHERE id = 5"], 5)  # noqa: S608 - words of our own
            for change in (
                "reason = 'another'",
                "after = '{}'",
                "actor = 'Mallory'",
                "request_id = 'x'",
                "hash = 'x'",
                "previous_hash = 'x'",
            )
        ),
        (["DELETE FROM audit WHERE id = 5"], 6),
        (
            [
                "UPDATE audit SET id = CASE id WHEN 5 THEN -6 ELSE -5 END WHERE id IN (5, 6)",
                "UPDATE audit SET id = -id WHERE id < 0",
            ],
            5,
        ),
    ],
)
def test_a_record_edited_removed_or_exchanged_by_hand_is_named(log, changes, broken_id):
    for change in changes:
        _by_hand(log, change)
    report = _verify(log)
    assert (report.ok, report.first_broken_id, report.records) == (False, broken_id, 4)
    assert f"Record {broken_id}" in report.sentence


@pytest.mark.parametrize(("which", "broken_id"), [("id > 5", 1006), ("id = 18", 1018), ("id > 0", 1001)])
def test_records_renumbered_by_hand_are_found_with_and_without_a_head(log, which, broken_id):
    with open_reading(log) as session:
        head = audit.head(session)
        assert _count(session) == 18
    _by_hand(log, f"UPDATE audit SET id = id + 1000 WHERE {which}")  # noqa: S608 - words of our own
    for known in (None, head):
        report = _verify(log, known)
        assert (report.ok, report.first_broken_id) == (False, broken_id)
        assert "renumbered" in report.sentence


def test_a_tail_cut_off_is_found_only_with_a_head_from_outside(log):
    with open_writing(log) as session:
        head = audit.head(session)
        audit.append(session, SYSTEM, "counted", "numbers/10")
    assert _verify(log, head).ok  # a head of before is still in the chain
    _by_hand(log, "DELETE FROM audit WHERE id > 8")
    assert _verify(log).ok
    report = _verify(log, head)
    assert not report.ok
    assert "rewritten" in report.sentence


def test_many_writers_at_once_keep_one_chain(log):
    def write(number: int) -> None:
        with open_writing(log) as session:
            audit.append(session, SYSTEM, "raced", f"numbers/{number}")

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(write, range(60)))
    report = _verify(log)
    assert report.ok
    with open_reading(log) as session:
        assert _count(session) == report.records
        assert len(audit.list_records(session, limit=1000)) == report.records


def test_the_database_itself_refuses_to_change_a_record(log):
    for statement in ("UPDATE audit SET reason = 'x'", "DELETE FROM audit"):
        with pytest.raises(sa.exc.DBAPIError, match=r"audit .*never"), open_writing(log) as session:
            session.connection().exec_driver_sql(statement)
    assert _verify(log).ok


def test_pages_are_newest_first_and_do_not_overlap(log):
    with open_reading(log) as session:
        first = audit.list_records(session, limit=4)
        second = audit.list_records(session, limit=4, before_id=first[-1].id)
    ids = [record.id for record in (*first, *second)]
    assert ids == sorted(ids, reverse=True)
    assert len(set(ids)) == 8
    with open_reading(log) as session:
        assert [record.object for record in audit.list_records(session, subject="numbers/3")] == ["numbers/3"]


@pytest.mark.parametrize(
    ("name", "title", "unit"),
    [
        ("ground_state", "On ground", ""),
        ("initial.f_m", "Initial, f", "mm"),
        ("typical_sigma.b2_per_m2", "Typical sigma, b2", "m⁻²"),
        ("detector.pixel_pitch_m", "Detector, Pixel pitch", "m"),
        ("centroid_sigma_px", "Centroid sigma", "px"),
        ("bound.incumbent_sha256", "Bound, Baseline, SHA-256", ""),
        ("expires_utc", "Expires", ""),
        ("must_change_password", "Must still set their own password", ""),
    ],
)
def test_a_member_has_a_name_and_the_unit_it_is_shown_in(name, title, unit):
    assert (name_member(name), find_unit(name)) == (title, unit)


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (True, "yes"),
        (False, "no"),
        ([], "none"),
        (["viewer", "analyst"], "viewer, analyst"),
        ("2026-11-21T03:04:05.123456Z", "2026-11-21T03:04:05.123456Z"),  # pages show it as each person chose
        ("c" * 64, "cccccccc"),
        (7, "7"),
        (1.0 / 3.0, "0.3333333"),
        ([1, 2], "[1, 2]"),
        ("x" * 200, "x" * 120 + "…"),
    ],
)
def test_a_value_is_printed_for_people(value, shown):
    assert changes(None, {"thing": value})[0].after == shown


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=20,
)


def _export(engine: Engine, form: str = "jsonl", policy: Policy | None = None) -> bytes:
    stream = io.BytesIO()
    with open_reading(engine) as session:
        write_export(session, stream, form, policy or Policy())
    return stream.getvalue()


@pytest.fixture
def small_log(engine) -> Engine:
    with open_writing(engine) as session:
        audit.append(session, SYSTEM, "counted", "numbers/1", None, {"ψ": 1e22, "σ": [0.1, -0.0, None]}, 'a "reason"\n')
        audit.append(session, SYSTEM, "counted", "numbers/2", {"n": 1}, {"n": 2})
    return engine


def _head(engine: Engine) -> str:
    with open_reading(engine) as session:
        return audit.head(session)


def test_an_export_verifies_and_tells_the_head_of_the_log_and_whether_four_eyes_are_enforced(small_log):
    good, sentence = verify(io.BytesIO(_export(small_log)))
    assert good, sentence
    assert f"head {_head(small_log)}" in sentence
    for policy in (Policy(), Policy(four_eyes=False)):
        assert json.loads(_export(small_log, policy=policy).splitlines()[-1])["four_eyes"] is policy.four_eyes
    with pytest.raises(RefusedInputError, match=" or ".join(FORMS)):
        _export(small_log, "xml")


@pytest.mark.full
def test_any_flipped_bit_is_found(small_log):
    whole, chosen = _export(small_log), np.random.default_rng(1)
    for place in range(len(whole)):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << int(chosen.integers(8))
        good, sentence = verify(io.BytesIO(bytes(flipped)))
        assert not good, (place, sentence)


@pytest.mark.parametrize("cut", [0, 1, 2])
def test_a_record_that_is_missing_moved_or_repeated_is_found(small_log, cut):
    lines = _export(small_log).splitlines(keepends=True)
    without = lines[:cut] + lines[cut + 1 :]
    exchanged = [*lines[:cut], lines[cut + 1], lines[cut], *lines[cut + 2 :]]
    twice = [*lines[: cut + 1], *lines[cut:]]
    for changed in (without, exchanged, twice, lines[: cut + 1], [*lines, lines[cut]]):
        assert not verify(io.BytesIO(b"".join(changed)))[0]


def test_a_chain_rebuilt_from_an_edit_on_is_found_only_with_a_head_from_before(small_log):
    lines = _export(small_log).splitlines()
    records = [json.loads(line) for line in lines[:-1]]
    records[0]["actor"] = "Mallory"
    previous = chain.FIRST_HASH
    for record in records:
        record["previous_hash"], record["hash"] = previous, compute_hash(previous, record)
        previous = record["hash"]
    forged = _exported(records, json.dumps(json.loads(lines[-1]) | {"head": previous}).encode())
    assert verify(io.BytesIO(forged))[0]
    good, sentence = verify(io.BytesIO(forged), _head(small_log))
    assert not good
    assert "rewritten" in sentence


@pytest.mark.parametrize("first", [0, 3, -1])
def test_records_renumbered_in_the_database_are_found_in_its_export(small_log, first):
    lines = _export(small_log).splitlines()
    records = [json.loads(line) for line in lines[:-1]]
    for record in records[first:]:
        record["id"] += 1000  # outside the hash of a record
    good, sentence = verify(io.BytesIO(_exported(records, lines[-1])), _head(small_log))
    line = range(1, len(records) + 1)[first]
    assert (good, f"Line {line} " in sentence) == (False, True), sentence


def test_a_gap_is_let_pass_before_a_record_of_an_older_version_only(small_log):
    lines, previous = _export(small_log).splitlines(), chain.FIRST_HASH
    records = [json.loads(line) for line in lines[:-1]]
    for record, skipped in zip(records, (0, 3, *[3] * len(records)), strict=False):
        record.update(id=record["id"] + skipped, previous_hash=previous)
        if record["id"] < 7:
            record["roles"] = None
        record["hash"] = previous = compute_hash(previous, record)
    old, new = records[1], records[-1]
    assert (old["roles"], new["roles"] is None) == (None, False)
    last = json.dumps(json.loads(lines[-1]) | {"head": previous}).encode()
    assert verify(io.BytesIO(_exported(records, last)))[0]
    new["id"] += 1
    assert not verify(io.BytesIO(_exported(records, last)))[0]


def _exported(records: list[dict[str, Any]], last_line: bytes) -> bytes:
    body = b"".join(f"{canonical(record)}\n".encode() for record in records)
    last = json.loads(last_line)
    del last["sha256"]
    last["sha256"] = hashlib.sha256(body + canonical(last).encode()).hexdigest()
    return body + f"{canonical(last)}\n".encode()


def test_the_program_in_the_zip_runs_without_boresight_and_finds_a_flipped_byte(small_log, tmp_path):
    with zipfile.ZipFile(io.BytesIO(_export(small_log, "zip"))) as archive:
        archive.extractall(tmp_path)
    assert (tmp_path / "verify_audit.py").read_text() == verifier()
    good = _bare(tmp_path, "--head", _head(small_log))
    assert (good.returncode, f"head {_head(small_log)}" in good.stdout) == (0, True), good.stderr
    whole = bytearray((tmp_path / "audit.jsonl").read_bytes())
    whole[len(whole) // 3] ^= 1
    (tmp_path / "audit.jsonl").write_bytes(whole)
    bad = _bare(tmp_path)
    assert (bad.returncode, bool(re.search(r"(Line|Record) \d+ ", bad.stderr))) == (1, True)


def _bare(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-I", "-S", "verify_audit.py", "audit.jsonl", *options]
    return subprocess.run(command, cwd=folder, env={}, capture_output=True, text=True, check=False)


@given(after=st.none() | st.dictionaries(st.text(max_size=8), JSON), text=st.text(), number=st.none() | st.integers())
def test_the_store_and_the_verifier_hash_every_record_alike(after, text, number):
    record = dict.fromkeys(chain.COLUMNS) | {"after": after, "actor_id": number, "id": 1}
    record |= {name: text for name in chain.TEXTS if name not in ("reason", "request_id")}
    raw = record | {"after": None if after is None else canonical(after)}
    assert chain.compute_hash(chain.FIRST_HASH, raw) == compute_hash(chain.FIRST_HASH, record)
    assert chain.spelled(raw | {"hash": "h", "previous_hash": "p"}) == canonical(
        record | {"hash": "h", "previous_hash": "p"}
    )


def test_the_light_says_whether_the_chain_holds_of_a_long_one_when_asked(site, read):
    visitor = site.visitor("victor")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("boresight.console.audit.pages.VERIFIED_AT_EVERY_VISIT", 1)
        assert "NOT VERIFIED" in read(visitor.get("/audit"))
        assert "CHAIN INTACT" in read(visitor.get("/audit?verify=1"))
    assert "CHAIN INTACT" in read(visitor.get("/audit"))
    with site.engine.begin() as connection:
        drop_triggers(connection)
        connection.exec_driver_sql("UPDATE audit SET reason = 'altered' WHERE id = 2")
    page = read(visitor.get("/audit"))
    assert "CHAIN BROKEN" in page
    assert "Record 2 " in page


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
    assert "Run 1" in page
    assert "Run 2" not in page
    assert "<option selected>tested</option>" in visitor.get("/audit?action=tested")
    assert 'class="empty"' in visitor.get("/audit?since=2100-01-01")
    assert "Run 2" in read(visitor.get("/audit?since=2020-01-01T00:00Z&until=2100-01-01&action=tested"))
    assert "not-a-time" in codes(visitor.get("/audit?since=soon"))
    page = visitor.get("/audit?object=users/2")
    assert ('title="users/2"' in page, 'title="users/3"' in page) == (True, False)


def test_a_record_is_shown_whole_with_names_and_units(site, read):
    before, after = {"initial": {"f_m": 0.016}, "version": 1}, {"initial": {"f_m": 0.0161}, "version": 2}
    with open_writing(site.engine) as session:
        record = audit.append(session, site.actor("ada"), "edited", "sensors/1", before, after, "focus moved")
    page = read(site.visitor("victor").get(f"/audit/{record.id}"))
    for said in (
        "Initial, f",
        "mm",
        "16.1",
        "focus moved",
        "Roles at that time analyst",
        "Rows sealed none by this record",
    ):
        assert said in page, said
    assert site.visitor("victor").send("GET", "/audit/99999", headers={"accept": "text/html"}).status_code == 404


def test_the_bar_tells_through_which_record_the_chain_was_verified(site):
    visitor = site.visitor("victor")
    assert "UNVERIFIED" in visitor.get("/sensors").split("<main")[0]
    site.app.state.maintenance.verify()
    with open_reading(site.engine) as session:
        last = audit.list_records(session, limit=1)[0].id
    assert f"#{last} " in visitor.get("/sensors").split("<main")[0]
    with site.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE users SET roles = '[]' WHERE id = 1")
    site.app.state.maintenance.verify()
    assert "BROKEN" in visitor.get("/sensors").split("<main")[0]


def test_only_what_differs_is_shown_and_nested_members_by_their_path():
    found = changes({"a": 1, "b": {"c": 2.0, "d": "x"}}, {"a": 1, "b": {"c": 2.5, "d": "x"}, "e": ["p", "q"]})
    assert [(it.name, it.before, it.after) for it in found] == [("b.c", "2", "2.5"), ("e", "–", "p, q")]
    found = changes({"gone": 1}, {"sha256": "ab" * 32})
    assert [(it.name, it.after) for it in found] == [("sha256", "abababab"), ("gone", "–")]


@pytest.mark.parametrize(
    ("after", "gist"),
    [
        ({"run_id": 41}, "Run 41"),  # a bare number names nothing
        ({"run_id": 41, "state": "ASKED"}, "ASKED"),
        ({"set": "PS-1", "sha256": "ab" * 32, "verdict": "FAIL"}, "PS-1 · FAIL"),
    ],
)
def test_a_change_is_summarised_by_what_tells_most_and_a_bare_value_has_its_name(site, after, gist):
    with open_writing(site.engine) as session:
        assert make_audit_line(audit.append(session, site.actor("ada"), "did", "runs/1", None, after)).gist == gist


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
