"""Reports, checks, people, schema and audit from the command line, and what every command owes a terminal."""

import json
import os
import pty
import socket
import subprocess
import sys
import time

import pytest

from boresight.cli import main
from boresight.cli.output import progress
from boresight.errors import BoresightError, Fault, RefusedInputError
from boresight.platform.db.sessions import current_revision, head_revision, open_engine
from tests.cli.conftest import assert_refused
from tests.stores import url_in

COMMANDS = (
    "calibrate", "match", "evaluate", "convert", "assess", "reproduce", "check", "simulate", "report", "export", "table",
    "serve", "demo", "warm", "migrate", "backup", "restore", "user", "audit",
)  # fmt: skip
PASSWORD = "correct horse battery"


def test_the_contract_s_commands_are_there():
    assert set(COMMANDS) <= set(main.commands)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(boresight, command):
    done = boresight(command, "--help")
    assert done.exit_code == 0
    assert len(done.stdout) > 100


def test_help_loads_no_heavy_library():
    heavy = ("numpy", "numba", "fastapi", "sqlalchemy", "plotly", "distributed", "pyarrow")
    code = f"import sys, boresight.cli; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_module_runs_as_the_command():
    done = subprocess.run([sys.executable, "-m", "boresight", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("boresight, version ")


def test_check_prints_the_findings_and_writes_the_report(boresight, simulated, tmp_path):
    path = tmp_path / "quality.json"
    done = boresight("check", simulated / "calibration.csv", "--sensor", simulated / "sensor.json", "--json", path)
    assert done.exit_code == 0
    assert "matched" in done.stdout
    assert json.loads(path.read_text())["frames"] == 40


def test_report_writes_one_file_from_a_calibration_json(boresight, calibration, tmp_path):
    path = tmp_path / "report.html"
    done = boresight("report", calibration, "--out", path)
    assert done.exit_code == 0
    assert "ST16-4" in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("content", ["{", "[]", '{"schema": "boresight.quality/1"}'])
def test_report_refuses_what_is_no_calibration(boresight, tmp_path, content):
    source = tmp_path / "other.json"
    source.write_text(content)
    done = boresight("report", source, "--out", tmp_path / "report.html")
    assert_refused(done, lines=1)
    assert not (tmp_path / "report.html").exists()


def test_report_of_a_run_that_is_not_stored_is_refused(store, tmp_path):
    done = store("report", "12", "--out", tmp_path / "report.html")
    assert_refused(done, "12")


@pytest.mark.parametrize(("setting", "said"), [("1", False), ("0", True)])
def test_the_report_of_a_stored_run_says_where_one_person_works_alone(
    store, calibration_result, tmp_path, monkeypatch, setting, said
):
    monkeypatch.setenv("BORESIGHT_FOUR_EYES", setting)
    monkeypatch.setattr("boresight.console.runs.service.final_result", lambda *_: calibration_result)
    done = store("report", "1", "--out", tmp_path / "report.html")
    assert done.exit_code == 0, done.stderr
    assert ("FOUR EYES ARE OFF" in (tmp_path / "report.html").read_text(encoding="utf-8")) is said


def test_the_schema_goes_forward_and_back(store):
    store("migrate", "--down", "base")  # a database of the tests on PostgreSQL has its schema already
    assert store("migrate").stdout.startswith("schema empty -> 0")
    assert store("migrate", "--down", "base").stdout.endswith("-> empty\n")


def test_a_schema_revision_that_is_not_there_is_refused_in_one_line(store):
    store("migrate")
    done = store("migrate", "--down", "xyz")
    assert done.exit_code == 1
    assert done.stderr.startswith("boresight: There is no schema revision 'xyz' to go back to; name base or 0001")
    assert done.stderr.count("\n") == 1


def test_a_person_is_added_once_and_the_audit_chain_knows(store):
    words = ("user", "add", "ada", "--role", "analyst", "--role", "approver", "--printed-name", "Ada L.")
    done = store(*words, "--password-stdin", stdin=f"{PASSWORD}\n")
    assert done.exit_code == 0
    assert "analyst, approver" in done.stdout
    assert PASSWORD not in done.stdout + done.stderr
    again = store(*words, "--password-stdin", stdin=f"{PASSWORD}\n")
    assert_refused(again, "ada")
    checked = store("audit", "verify")
    assert checked.exit_code == 0
    assert "head " in checked.stdout
    assert store("audit", "verify", "--head", "f" * 64).exit_code == 1


def test_a_password_is_asked_for_twice_where_none_is_piped(store):
    words = ("user", "add", "bob", "--role", "viewer", "--printed-name", "Bob")
    assert store(*words, stdin=f"{PASSWORD}\n{PASSWORD}\n").exit_code == 0


def test_an_empty_password_on_standard_input_is_refused(store):
    done = store("user", "add", "eve", "--role", "viewer", "--printed-name", "Eve", "--password-stdin", stdin="")
    assert_refused(done, "no password")


@pytest.mark.parametrize("command", ["serve", "demo"])
def test_a_port_that_is_taken_is_refused_with_what_to_do(boresight, tmp_path, command):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        done = boresight(command, "--port", taken.getsockname()[1], "--data", tmp_path)
    assert_refused(done, "--port", lines=1)


def refusing(error, monkeypatch):
    def fail(**_):
        raise error

    monkeypatch.setattr(main.commands["migrate"], "callback", fail)


def test_more_than_ten_faults_are_counted_not_listed(boresight, monkeypatch):
    faults = tuple(Fault(row, "row_px", "is text; give a number.") for row in range(2, 15))
    refusing(RefusedInputError("The file has faults.", faults), monkeypatch)
    lines = boresight("migrate").stderr.splitlines()
    assert lines[0] == "boresight: The file has faults."
    assert len(lines) == 12
    assert lines[-1] == "  and 3 more."


@pytest.mark.parametrize(
    ("error", "code"),
    [(BoresightError("No."), 1), (ValueError("odd"), 1), (KeyboardInterrupt(), 130)],
)
def test_every_failure_is_one_line_and_an_exit_code(boresight, monkeypatch, error, code):
    refusing(error, monkeypatch)
    done = boresight("migrate")
    assert done.exit_code == code
    assert done.stderr.startswith("boresight: ")
    assert done.stderr.count("\n") == 1


def test_debug_shows_the_traceback(boresight, monkeypatch):
    refusing(ValueError("odd"), monkeypatch)
    with pytest.raises(ValueError, match="odd"):
        boresight("--debug", "migrate")


def test_without_a_terminal_long_work_is_one_plain_line_and_short_work_none(capsys, monkeypatch):
    monkeypatch.setattr("boresight.cli.output.PATIENCE_S", 0.05)
    with progress("counting stars"):
        pass
    assert capsys.readouterr().err == ""
    with progress("counting stars") as report:
        report("weighing stars", 0.5)
        time.sleep(0.2)
    assert capsys.readouterr().err == "boresight: weighing stars ...\n"


def test_in_a_terminal_long_work_shows_a_bar():
    code = (
        "import time; from boresight.cli.output import progress\n"
        "with progress('counting') as report:\n"
        "    for step in range(16):\n"
        "        report('counting', step / 16); time.sleep(0.1)\n"
    )
    terminal, stderr = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "80"}
    subprocess.run([sys.executable, "-c", code], stderr=stderr, env=environment, check=True)
    os.close(stderr)
    shown = os.read(terminal, 65536).decode()
    os.close(terminal)
    assert "counting" in shown
    assert "%" in shown


@pytest.fixture(autouse=True)
def _own_files(monkeypatch, tmp_path):
    monkeypatch.setenv("BORESIGHT_BLOBS", str(tmp_path / "blobs"))


def _add(store, name):
    words = ("user", "add", name, "--role", "analyst", "--printed-name", f"Analyst {name}", "--password-stdin")
    assert store(*words, stdin=f"{PASSWORD}\n").exit_code == 0


def _revision(folder):
    engine = open_engine(url_in(folder))
    try:
        return current_revision(engine)
    finally:
        engine.dispose()


def test_what_a_way_back_removes_is_told_and_wants_agreement_and_a_backup_of_just_now(store, tmp_path):
    _add(store, "ana")
    assert store("backup", "--out", tmp_path / "old.zip").exit_code == 0
    _add(store, "bo")
    for words in ((), ("--yes",), ("--backup", tmp_path / "old.zip"), ("--yes", "--backup", tmp_path / "old.zip")):
        refused = store("migrate", "--down", "base", *words)
        assert (refused.exit_code, "removes 2 rows of users" in refused.stdout) == (1, True), words
        assert "Nothing was changed" in refused.stderr
        assert _revision(tmp_path) == head_revision()
    _add(store, "cy")  # the tables are all there
    assert store("backup", "--out", tmp_path / "new.zip").exit_code == 0
    done = store("migrate", "--down", "base", "--yes", "--backup", tmp_path / "new.zip")
    assert (done.exit_code, "removes 3 rows of users" in done.stdout) == (0, True), done.stderr
    assert _revision(tmp_path) is None


def test_a_way_back_that_removes_columns_with_content_names_them(store, tmp_path):
    _add(store, "ana")
    refused = store("migrate", "--down", "0002")
    assert refused.exit_code == 1
    assert "removes audit.rows of" in refused.stdout
    assert _revision(tmp_path) == head_revision()


def test_a_way_back_on_an_empty_store_asks_nothing(store, tmp_path):
    store("migrate")
    assert store("migrate", "--down", "base").exit_code == 0
    assert _revision(tmp_path) is None


def test_what_is_no_backup_is_refused(store, tmp_path):
    _add(store, "ana")
    (tmp_path / "a.zip").write_text("no zip")
    refused = store("migrate", "--down", "base", "--yes", "--backup", tmp_path / "a.zip")
    assert (refused.exit_code, "cannot be read as a backup" in refused.stderr) == (1, True)
    assert _revision(tmp_path) == head_revision()
