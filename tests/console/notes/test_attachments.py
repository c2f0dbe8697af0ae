"""Files at notes: of known kinds and sizes, by the note's author, given back byte for byte and never as a page."""

from dataclasses import replace

import pytest

from boresight.console.notes import service as notes
from boresight.console.notes.attachments import MOST_ATTACHMENTS, attach, check_file
from boresight.errors import BoresightError, ConflictError, ForbiddenError, NotFoundError, RefusedInputError
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import mark_dry_run, open_writing
from boresight.platform.web.middleware import ATTACHMENT_LIMIT_BYTES

CONTENT = b"12:00 safe mode\n"


@pytest.fixture
def note(session, people):
    return notes.add_note(session, people["ana"], "sensors", 1, "See the log.")


def test_a_file_stands_at_its_note_by_the_sha256_of_its_bytes_and_on_record(session, people, blobs, note):
    blobs.put(CONTENT)
    row = attach(session, people["ana"], blobs, note.id, check_file("C:\\passes\\ 4711.LOG", CONTENT))
    assert [(one.name, one.size_bytes) for one in notes.list_notes(session, "sensors", 1)[0].attachments] == [
        ("4711.LOG", len(CONTENT))
    ]
    assert blobs.read(row.sha256) == CONTENT
    record = audit.find_last_change(session, f"sensors/1/notes/{note.id}")
    assert (record.action, record.after["sha256"]) == ("attached", row.sha256)


@pytest.mark.parametrize(
    "name",
    [
        "",
        "log",
        ".txt",
        "page.html",
        "page.htm",
        "drawing.svg",
        "run.js",
        "a.txt.exe",
        "a\u202etxt.log",
        "x" * 121 + ".txt",
    ],
)
def test_only_kinds_that_no_browser_runs_are_attached(name):
    with pytest.raises(RefusedInputError):
        check_file(name, CONTENT)


@pytest.mark.parametrize("size", [0, ATTACHMENT_LIMIT_BYTES + 1])
def test_neither_an_empty_nor_a_large_file_is_attached(size):
    with pytest.raises(RefusedInputError):
        check_file("a.txt", b"x" * size)


def test_only_the_author_attaches_and_no_more_than_ten(session, people, blobs, note):
    file = check_file("a.txt", CONTENT)
    with pytest.raises(ForbiddenError):
        attach(session, people["dee"], blobs, note.id, file)
    with pytest.raises(NotFoundError):
        attach(session, people["ana"], blobs, 99, file)
    with pytest.raises(ForbiddenError):
        attach(session, replace(people["ana"], roles=frozenset({"viewer"})), blobs, note.id, file)
    with pytest.raises(NotFoundError):  # its bytes were not stored before
        attach(session, people["ana"], blobs, note.id, file)
    blobs.put(CONTENT)
    for _ in range(MOST_ATTACHMENTS):
        attach(session, people["ana"], blobs, note.id, file)
    with pytest.raises(ConflictError):
        attach(session, people["ana"], blobs, note.id, file)


def test_a_dry_run_stores_no_bytes(session, people, blobs, note):
    mark_dry_run(session)
    row = attach(session, people["ana"], blobs, note.id, check_file("a.txt", CONTENT))
    with pytest.raises(BoresightError):
        blobs.read(row.sha256)


def _add(visitor, name, content):
    form = {"csrf_token": visitor.csrf_token, "text": "See there."}
    return visitor.send("POST", "/notes/sensors/1", data=form, files={"file": (name, content)})


def test_a_page_takes_a_file_with_a_note_and_gives_it_back_as_a_download_that_no_browser_opens(site):
    ada, large = site.visitor("ada"), b"x" * 4_000_000
    assert _add(ada, "large.txt", large).status_code == 303
    page = ada.get("/sensors/1")
    assert "large.txt" in page
    answer = site.visitor("victor").send("GET", "/api/v1/notes/1/attachments/1")
    assert answer.content == large
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["content-disposition"] == 'attachment; filename="large.txt"'
    assert answer.headers["x-content-type-options"] == "nosniff"


def _attach(visitor, name, content):
    headers = {"X-CSRF-Token": visitor.csrf_token}
    return visitor.send("POST", "/api/v1/notes/1/attachments", files={"file": (name, content)}, headers=headers)


def test_bytes_are_stored_before_the_transaction_and_go_again_where_nothing_names_them(site, monkeypatch):
    ada, alan, put, stored = site.visitor("ada"), site.visitor("alan"), site.blobs.put, []

    def store(content):
        assert not site.app.state.write_lock.locked()
        with open_writing(site.engine):  # another writer is not kept waiting
            stored.append(put(content))
        return stored[-1]

    monkeypatch.setattr(site.blobs, "put", store)
    assert _add(ada, "a.txt", CONTENT).status_code == 303
    assert _attach(ada, "b.txt", b"more").status_code == 201
    assert _attach(alan, "c.txt", b"of another").status_code == 403  # in the transaction
    assert _attach(alan, "c.txt", CONTENT).status_code == 403
    form = {"csrf_token": ada.csrf_token, "text": " "}
    assert ada.send("POST", "/notes/sensors/1", data=form, files={"file": ("d.txt", b"of no note")}).status_code == 422
    assert _attach(site.visitor("victor"), "e.txt", b"of a viewer").status_code == 403  # before anything is stored
    kept = [site.blobs.locate(sha256).exists() for sha256 in stored]
    assert kept == [True, True, False, True, False]


def test_a_refused_file_leaves_no_note_and_what_was_typed(site):
    answer = _add(site.visitor("ada"), "page.html", CONTENT)
    assert answer.status_code == 422
    assert "See there." in answer.text
    assert _add(site.visitor("ada"), "large.txt", b"x" * 7_000_000).status_code == 413
    assert "See there." not in site.visitor("ada").get("/sensors/1")


def test_a_file_whose_bytes_were_changed_is_not_given(site):
    _add(site.visitor("ada"), "a.txt", CONTENT)
    sha256 = site.visitor("ada").send("GET", "/api/v1/sensors/1/notes").json()["items"][0]["attachments"][0]["sha256"]
    path = site.blobs.path(sha256)
    path.chmod(0o644)
    path.write_bytes(b"something else")
    assert site.visitor("victor").send("GET", "/api/v1/notes/1/attachments/1").status_code >= 409
