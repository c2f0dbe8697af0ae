"""Reports, checks, people, schema and audit from the command line, what every command owes a terminal, and where it writes."""

import csv
import hashlib
import io
import json
import os
import pty
import socket
import subprocess
import sys
import time
import zipfile

import pytest

from boresight.cli import main
from boresight.console.fleet import service as sensors
from boresight.errors import BoresightError, Fault, RefusedInputError
from boresight.library.progress import progress
from boresight.platform.actors import COMMAND_LINE
from boresight.platform.db.sessions import current_revision, head_revision, open_engine, open_writing
from tests.cli.conftest import accepted, assert_refused, read_rows
from tests.library.test_import import HEAVY, loaded_by
from tests.stores import open_migrated, url_in

COMMANDS = (
    "calibrate", "choose", "match", "evaluate", "convert", "assess", "reproduce", "check", "simulate", "report", "export", "submit",
    "table", "serve", "demo", "warm", "migrate", "backup", "restore", "user", "audit",
)  # fmt: skip
PASSWORD = "correct horse battery"


def test_the_contract_s_commands_are_there():
    assert set(COMMANDS) <= set(main.commands)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(boresight, command):
    done = accepted(boresight(command, "--help"))
    assert len(done.stdout) > 100


@pytest.mark.parametrize("words", [["--help"], ["calibrate", "--help"]], ids=" ".join)
def test_help_loads_next_to_nothing(words):
    code = f"from boresight.cli import main\nmain({words}, standalone_mode=False)"
    loaded = loaded_by(code)
    assert [name for name in HEAVY if name in loaded] == []
    assert len(loaded) < 200, loaded  # what they cost is what they load: two thirds of it are Python's own and click's


def test_the_module_runs_as_the_command():
    done = subprocess.run([sys.executable, "-m", "boresight", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("boresight, version ")


def test_check_prints_the_findings_and_writes_the_report(boresight, simulated, tmp_path):
    path = tmp_path / "quality.json"
    done = accepted(
        boresight("check", simulated / "calibration.csv", "--sensor", simulated / "sensor.json", "--json", path)
    )
    report = json.loads(path.read_text())
    assert report["frames"] == 40
    facts = [
        line for line in done.stdout.splitlines() if line and not line.startswith(("NORMAL", "CAUTION", "SERIOUS"))
    ]
    assert len(facts) <= 16
    assert any(line.split() == ["matched", f"{report['matched']:,}"] for line in facts)
    assert all(finding["sentence"] in done.stdout for finding in report["findings"])
    assert "diagnosis." not in done.stdout


def test_a_file_without_a_profile_is_looked_at_and_gets_one(boresight, tmp_path):
    own = tmp_path / "own.csv"
    own.write_text("Row,Col,Time,mag\n10.5,20.25,2026-01-01T00:00:00Z,4.5\n11.5,30.25,2026-01-01T00:00:01Z,4.6\n")
    alone = boresight("import", own)
    assert alone.exit_code == 1
    assert "--print-profile" in alone.stderr
    drafted = boresight("import", own, "--print-profile", "--json", tmp_path / "mine.json")
    assert "row.origin" in drafted.stderr
    done = boresight("import", own, "--profile", tmp_path / "mine.json", "--out", tmp_path / "t.csv")
    assert done.exit_code == 0, done.stderr
    assert (tmp_path / "t.csv").read_text().count("\n") == 3


def test_report_writes_one_file_from_a_calibration_json(boresight, calibration, tmp_path):
    path = tmp_path / "report.html"
    accepted(boresight("report", calibration, "--out", path))
    assert "ST16-4" in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("content", ["{", "[]", '{"schema": "boresight.quality/1"}'])
def test_report_refuses_what_is_no_calibration(boresight, tmp_path, content):
    source = tmp_path / "other.json"
    source.write_text(content)
    assert_refused(boresight("report", source, "--out", tmp_path / "report.html"), lines=1)
    assert not (tmp_path / "report.html").exists()


def test_report_of_a_run_that_is_not_stored_is_refused(store, tmp_path):
    assert_refused(store("report", "12", "--out", tmp_path / "report.html"), "12")


@pytest.mark.few(1)
@pytest.mark.parametrize(("setting", "said"), [("1", False), ("0", True)])
def test_the_report_of_a_stored_run_says_where_one_person_works_alone(
    store, calibration_result, tmp_path, monkeypatch, setting, said
):
    monkeypatch.setenv("BORESIGHT_FOUR_EYES", setting)
    monkeypatch.setattr("boresight.console.runs.service.get_final_result", lambda *_: calibration_result)
    accepted(store("report", "1", "--out", tmp_path / "report.html"))
    assert ("FOUR-EYES RULE OFF" in (tmp_path / "report.html").read_text(encoding="utf-8")) is said


def test_the_schema_goes_forward_and_back(store):
    store("migrate", "--down", "base")  # a database of the tests on PostgreSQL has its schema already
    assert store("migrate").stdout.startswith("schema empty -> 0")
    assert store("migrate", "--down", "base").stdout.endswith("-> empty\n")


def test_a_schema_revision_that_is_not_there_is_refused_in_one_line(store):
    store("migrate")
    done = store("migrate", "--down", "xyz")
    assert_refused(done, "'xyz'", "base or 0001", code="unknown-revision", lines=1)


def test_a_person_is_added_once_and_the_audit_chain_knows(store):
    words = ("user", "add", "ada", "--role", "analyst", "--role", "approver", "--printed-name", "Ada L.")
    done = accepted(store(*words, "--password-stdin", stdin=f"{PASSWORD}\n"))
    assert "analyst, approver" in done.stdout
    assert PASSWORD not in done.stdout + done.stderr
    assert_refused(store(*words, "--password-stdin", stdin=f"{PASSWORD}\n"), "ada")
    checked = accepted(store("audit", "verify"))
    assert "head " in checked.stdout
    assert store("audit", "verify", "--head", "f" * 64).exit_code == 1


def test_a_password_is_asked_for_twice_where_none_is_piped(store):
    words = ("user", "add", "bob", "--role", "viewer", "--printed-name", "Bob")
    accepted(store(*words, stdin=f"{PASSWORD}\n{PASSWORD}\n"))


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
    monkeypatch.setattr("boresight.library.progress.PATIENCE_S", 0.05)
    with progress("counting stars"):
        pass
    assert capsys.readouterr().err == ""
    with progress("counting stars") as report:
        report("weighing stars", 0.5)
        time.sleep(0.2)
    assert capsys.readouterr().err == "boresight: weighing stars ...\n"


def test_in_a_terminal_long_work_shows_a_bar():
    code = (
        "import time; from boresight.library.progress import progress\n"
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
    accepted(store(*words, stdin=f"{PASSWORD}\n"))


def _revision(folder):
    engine = open_engine(url_in(folder))
    try:
        return current_revision(engine)
    finally:
        engine.dispose()


def test_what_a_way_back_removes_is_told_and_wants_agreement_and_a_backup_of_just_now(store, tmp_path):
    _add(store, "ana")
    accepted(store("backup", "--out", tmp_path / "old.zip"))
    _add(store, "bo")
    for words in ((), ("--yes",), ("--backup", tmp_path / "old.zip"), ("--yes", "--backup", tmp_path / "old.zip")):
        refused = store("migrate", "--down", "base", *words)
        assert (refused.exit_code, "removes 2 rows of users" in refused.stdout) == (1, True), words
        assert "Nothing was changed" in refused.stderr
        assert _revision(tmp_path) == head_revision()
    _add(store, "cy")  # the tables are all there
    accepted(store("backup", "--out", tmp_path / "new.zip"))
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
    accepted(store("migrate", "--down", "base"))
    assert _revision(tmp_path) is None


def test_what_is_no_backup_is_refused(store, tmp_path):
    _add(store, "ana")
    (tmp_path / "a.zip").write_text("no zip")
    refused = store("migrate", "--down", "base", "--yes", "--backup", tmp_path / "a.zip")
    assert_refused(refused, code="unreadable-backup")
    assert _revision(tmp_path) == head_revision()


def in_folder(folder, *words):
    return subprocess.run(
        [sys.executable, "-m", "boresight", *map(str, words)], cwd=folder, capture_output=True, timeout=120, check=False
    )


@pytest.mark.full
def test_a_report_goes_to_standard_output_and_no_file_is_made(calibration, tmp_path):
    done = in_folder(tmp_path, "report", calibration, "--out", "-")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(b"<!doctype html>")
    assert done.stdout.rstrip().endswith(b"</html>")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["report.pdf", "report.PDF", "report.docx", "report.json", "report.txt"])
def test_a_report_is_html_and_no_other_ending_is_written(boresight, calibration, tmp_path, name):
    done = boresight("report", calibration, "--out", tmp_path / name)
    assert_refused(done, ".html", lines=1)
    assert ("print it to PDF" in done.stderr) == name.lower().endswith(".pdf")
    assert list(tmp_path.iterdir()) == []


def test_matches_go_to_standard_output_as_csv_and_the_counts_to_standard_error(boresight, simulated):
    words = ("match", simulated / "calibration.csv", "--sensor", simulated / "sensor.json")
    done = accepted(boresight(*words, "--out", "-"))
    given = read_rows(simulated / "calibration.csv")
    found = list(csv.DictReader(io.StringIO(done.stdout)))
    assert [(row["frame"], row["row_px"]) for row in found] == [(row["frame"], row["row_px"]) for row in given]
    assert "frames valid" in done.stderr
    both = boresight(*words, "--out", "-", "--json", "-")
    assert (both.exit_code, both.stdout) == (1, "")


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".jsonl", ".html", ".pdf", ".zip"])
@pytest.mark.parametrize("command", ["calibrate", "check", "match", "evaluate"])
def test_json_is_not_written_under_the_name_of_another_format(boresight, simulated, tmp_path, command, ending):
    words = {"match": ("--out", tmp_path / "out.csv"), "evaluate": ("--parameters", simulated / "truth.json")}
    done = boresight(
        command,
        simulated / "calibration.csv",
        "--sensor",
        simulated / "sensor.json",
        *words.get(command, ()),
        "--json",
        tmp_path / f"result{ending}",
    )
    assert_refused(done, "use the extension .json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ("match", "CALIBRATION", "--sensor", "SENSOR", "--out", "out.txt"),
        ("convert", "SENSOR", "--sensor", "SENSOR", "--to", "pinhole_radial", "--out", "out.csv"),
        ("audit", "export", "--out", "log.csv"),
        ("backup", "--out", "all.json"),
        ("backup", "--out", "-"),
        ("export", "PS-FM1-0", "--out", "package.json"),
        ("simulate", "st16-1", "--out", "-"),
        ("reproduce", "wu", "--quick", "--out", "-"),
    ],
)
def test_a_place_that_cannot_hold_what_is_written_is_refused_in_one_line(
    store, simulated, tmp_path, monkeypatch, words
):
    monkeypatch.chdir(tmp_path)
    files = {"CALIBRATION": simulated / "calibration.csv", "SENSOR": simulated / "sensor.json"}
    done = store(*(files.get(word, word) for word in words))
    assert_refused(done, lines=1)
    assert "unexpected" not in done.stderr
    assert not {"-", "out.txt", "out.csv", "log.csv", "all.json", "package.json"} & {
        path.name for path in tmp_path.iterdir()
    }


@pytest.mark.parametrize("member", ["schema", "status", "parameters", "sensor"])
@pytest.mark.parametrize("command", ["report", "assess"])
def test_a_calibration_without_a_member_it_needs_is_refused_by_the_name_of_that_member(
    boresight, calibration, simulated, tmp_path, command, member
):
    document = json.loads(calibration.read_text())
    del document[member]
    cut = tmp_path / "cut.json"
    cut.write_text(json.dumps(document))
    more = ["--out", tmp_path / "report.html"] if command == "report" else ["--sensor", simulated / "sensor.json"]
    assert_refused(boresight(command, cut, *more), "cut.json", f"({member}", code="incomplete-calibration")


INITIAL = {"s": 1.0, "f_m": 0.05, "u0_px": 512.3, "v0_px": 511.2, "k1": 0.01, "k2": -0.02}
SENSOR = {
    "name": "FM1",
    "detector": {"rows": 1024, "columns": 1024, "pixel_pitch_m": 1.5e-5},
    "camera_model": "pinhole_radial",
    "parity": -1,
    "centroid_sigma_px": 0.1,
    "initial": INITIAL,
    "typical_sigma": {"s": 1e-5, "f_m": 1e-7, "u0_px": 1.0, "v0_px": 1.0, "k1": 1e-2, "k2": 1e-1},
}
DEFINITION = {
    "table_id": "STR_CAM",
    "flight_software_version": "4.2.1",
    "length_bytes": 26,
    "fields": [
        {"name": name.upper(), "parameter": name, "offset_bytes": 4 * place, "type": "float32"}
        for place, name in enumerate(INITIAL)
    ],
    "crc": {"name": "CRC-16/ARC", "offset_bytes": 24},
}


@pytest.fixture
def files(tmp_path):
    for name, document in (("sensor", SENSOR), ("definition", DEFINITION), ("parameters", INITIAL)):
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
    return tmp_path


@pytest.fixture
def stocked(store, tmp_path):
    engine = open_migrated(url_in(tmp_path))
    with open_writing(engine) as session:
        sensors.register_sensor(session, COMMAND_LINE, SENSOR)
    engine.dispose()
    return store


def test_export_writes_the_same_package_each_time(stocked, tmp_path):
    first, again = tmp_path / "a.zip", tmp_path / "b.zip"
    done = stocked("export", "PS-FM1-0", "--out", first)
    stocked("export", "1", "--out", again)
    assert done.exit_code == 0
    assert hashlib.sha256(first.read_bytes()).hexdigest() in done.stdout
    assert first.read_bytes() == again.read_bytes()


def test_an_exported_package_verifies_with_sha256sum(stocked, tmp_path):
    stocked("export", "PS-FM1-0", "--out", tmp_path / "a.zip")
    with zipfile.ZipFile(tmp_path / "a.zip") as packed:
        packed.extractall(tmp_path / "out")
    checked = subprocess.run(["sha256sum", "-c", "SHA256SUMS"], cwd=tmp_path / "out", capture_output=True, check=False)
    assert checked.returncode == 0, checked.stdout


def test_export_names_what_it_cannot_find_and_what_has_no_table(stocked, tmp_path):
    unknown = stocked("export", "PS-FM1-9", "--out", tmp_path / "a.zip")
    other = stocked("export", "1", "--out", tmp_path / "a.zip", "--flight-software", "5")
    assert (unknown.exit_code, other.exit_code) == (1, 1)
    assert "no parameter set PS-FM1-9" in unknown.stderr
    assert "no table definition" in other.stderr


def _table(boresight, files, *words):
    sheets = ("--sensor", files / "sensor.json", "--definition", files / "definition.json")
    return boresight("table", *words, *sheets)


def test_a_table_is_written_and_read_without_a_store(boresight, files):
    image = files / "table.bin"
    written = _table(boresight, files, "encode", files / "parameters.json", "--out", image)
    read = _table(boresight, files, "decode", image)
    assert (written.exit_code, read.exit_code) == (0, 0)
    assert written.stdout.startswith(read.stdout.rstrip("\n"))
    assert "3D4CCCCD" in read.stdout
    assert "rounding moves a star by at most" in written.stdout


def test_a_damaged_table_is_refused_by_its_crc(boresight, files):
    image = files / "table.bin"
    _table(boresight, files, "encode", files / "parameters.json", "--out", image)
    damaged = bytearray(image.read_bytes())
    damaged[5] ^= 1
    image.write_bytes(damaged)
    assert_refused(_table(boresight, files, "decode", image), "CRC of table.bin does not match its bytes")


def test_a_definition_that_is_no_json_is_refused(boresight, files):
    (files / "definition.json").write_text("{")
    assert "definition.json is not JSON" in _table(boresight, files, "decode", files / "x").stderr
