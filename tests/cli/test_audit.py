"""`boresight audit verify` on a database that was edited by hand."""

import sqlite3
from contextlib import closing

import pytest

ADD = ("user", "add", "ana", "--role", "analyst", "--printed-name", "Ana", "--password-stdin")


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ("UPDATE users SET roles = '[\"administrator\"]'", "Record 1 sealed it otherwise: users/1 was changed"),
        ("UPDATE users SET password_hash = 'x'", "Record 1 sealed it otherwise: users/1 was changed"),
        ("DROP TRIGGER users_no_removal; DELETE FROM users", "users/1 was removed outside Boresight"),
        (
            "INSERT INTO users SELECT 2, 'eve', printed_name, password_hash, roles, created_utc, NULL, 0, 0 FROM users",
            "No record put it there: users/2 was inserted",
        ),
        ("DROP TRIGGER audit_no_change; UPDATE audit SET actor = 'Mallory'", "Record 1 is not as it was written"),
    ],
)
def test_an_edit_by_hand_is_found_and_named(store, tmp_path, edit, said):
    assert store(*ADD, stdin="correct horse battery\n").exit_code == 0
    assert store("audit", "verify").exit_code == 0
    with closing(sqlite3.connect(tmp_path / "boresight.sqlite3")) as connection:
        connection.executescript(edit)
    found = store("audit", "verify")
    assert found.exit_code == 1
    assert said in found.stderr
