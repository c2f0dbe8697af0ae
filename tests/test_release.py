"""A release: every licence is known and allowed, the bill of materials is whole, and the public key verifies the files."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import pytest

import boresight
from boresight.platform.audit.signing import SigningKey
from release import __main__ as command
from release import licences, vulnerabilities
from release.licences import Package, list_packages
from release.sbom import write_sbom
from release.vulnerabilities import is_affected, read_answer, scan_offline
from tests.console.operations import OPENAPI
from tests.platform.db.released import RELEASED

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MADE = datetime(2026, 11, 28, tzinfo=UTC)


@pytest.fixture(scope="module")
def packages() -> list[Package]:
    return list(list_packages())


def test_every_package_of_the_lock_file_has_a_licence_that_is_known_and_allowed(packages):
    locked = re.findall(r"^([a-z0-9.-]+)==", (ROOT / "requirements.lock").read_text(), re.MULTILINE)
    assert [one.name for one in packages] == locked
    assert [(one.name, one.licence) for one in packages if not one.is_allowed] == []


def test_what_the_extras_bring_is_allowed_too():
    for name in ("obstore", "psycopg", "psycopg-binary"):
        assert Package(name, "", (), licences.read_licence(name)).is_allowed, name


@pytest.mark.parametrize(
    ("expression", "allowed"),
    [
        ("MIT", True),
        ("GPL-3.0-only OR MIT", True),
        ("GPL-3.0-only AND MIT", False),
        ("MPL-2.0 AND (Apache-2.0 OR GPL-2.0-only)", True),
        ("Apache-2.0 WITH LLVM-exception", True),
        ("AGPL-3.0-or-later", False),
        ("", False),
    ],
)
def test_an_expression_is_allowed_by_any_part_of_an_or_and_every_part_of_an_and(expression, allowed):
    assert Package("x", "1", (), expression).is_allowed is allowed


def test_what_was_read_by_hand_is_needed_and_of_packages_that_are_there(packages):
    assert set(licences.READ) <= {one.name for one in packages}


def test_the_bill_of_materials_names_each_package_with_its_licence_and_is_the_same_each_time(packages):
    text = write_sbom("1.2.3", b"wheel", packages, MADE)
    bill = json.loads(text)
    assert text == write_sbom("1.2.3", b"wheel", packages, MADE)
    assert bill["serialNumber"] != json.loads(write_sbom("1.2.4", b"wheel", packages, MADE))["serialNumber"]
    assert (bill["bomFormat"], bill["specVersion"], bill["metadata"]["component"]["version"]) == (
        "CycloneDX",
        "1.6",
        "1.2.3",
    )
    assert bill["metadata"]["component"]["hashes"][0]["content"] == hashlib.sha256(b"wheel").hexdigest()
    assert {(one["name"], one["version"]) for one in bill["components"]} == {
        (one.name, one.version) for one in packages
    }
    assert all(one["licenses"] and one["purl"].startswith("pkg:pypi/") for one in bill["components"])
    (own,) = (one for one in bill["dependencies"] if one["ref"].startswith("pkg:pypi/boresight@"))
    assert len(own["dependsOn"]) == len(packages)


def record(name: str, *events: dict[str, str], **more: object) -> dict[str, object]:
    affected = {"package": {"ecosystem": "PyPI", "name": name}, "ranges": [{"type": "ECOSYSTEM", "events": [*events]}]}
    return {"id": f"PYSEC-{name}", "aliases": [f"CVE-{name}"], "summary": "A flaw.", "affected": [affected], **more}


@pytest.mark.parametrize(
    ("version", "affected"),
    [
        ("1.9", False), ("2.0", True), ("2.0.4", True), ("2.1", False), ("2.9", False),
        ("3.0rc1", False), ("3.0", True), ("3.2", True), ("3.2.1", False),
    ],
)  # fmt: skip
def test_a_version_is_affected_from_introduced_on_until_fixed_or_through_last_affected(version, affected):
    events = [{"introduced": "3.0"}, {"last_affected": "3.2"}, {"introduced": "2.0"}, {"fixed": "2.1"}]
    assert is_affected(version, {"ranges": [{"type": "ECOSYSTEM", "events": events}]}) is affected
    assert is_affected(version, {"versions": [version]})


def test_the_lock_file_is_scanned_offline_and_an_accepted_flaw_is_left_out(packages, tmp_path):
    jinja = next(one for one in packages if one.name == "jinja2")
    told = [
        record("Jinja2", {"introduced": "0"}),
        record("numpy", {"introduced": "0"}, {"fixed": "1.0"}),
        record("scipy", {"introduced": "0"}, withdrawn="2026-01-01T00:00:00Z"),
        record("not-installed", {"introduced": "0"}),
    ]
    with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
        for one in told:
            archive.writestr(f"{one['id']}.json", json.dumps(one))
    found = scan_offline(packages, tmp_path / "all.zip")
    assert [(one.package, one.version, one.names) for one in found.found] == [
        ("jinja2", jinja.version, ("PYSEC-Jinja2", "CVE-Jinja2"))
    ]
    assert (found.looked_up, found.unknown, found.exit_code) == (len(packages), (), 1)
    assert found.left_by(["CVE-Jinja2"]).exit_code == 0
    (tmp_path / "empty").mkdir()
    assert scan_offline(packages, tmp_path / "empty").exit_code == 3


def test_what_the_database_did_not_answer_for_is_not_called_sound(packages):
    sound = [{"name": one.name, "version": one.version, "vulns": []} for one in packages]
    assert read_answer(sound, packages).exit_code == 0
    skipped = [*sound[1:], {"name": packages[0].name, "skip_reason": "not found"}]
    assert read_answer(skipped, packages).exit_code == 3
    flawed = [*sound[1:], {"name": packages[0].name, "version": "1", "vulns": [{"id": "PYSEC-1", "aliases": []}]}]
    assert read_answer(flawed, packages).exit_code == 1


def test_without_any_database_one_sentence_says_that_nothing_was_scanned(packages, monkeypatch):
    monkeypatch.setattr(vulnerabilities.sys, "executable", shutil.which("false"))
    told = vulnerabilities.scan(packages, None)
    assert (told.looked_up, told.exit_code, len([*told.lines()])) == (0, 3, 1)


RELEASE = (sys.executable, "-m", "release", "--without-documentation")


def test_a_release_without_the_documentation_is_refused_unless_asked_for(tmp_path, monkeypatch):
    monkeypatch.setattr(command, "ROOT", tmp_path)
    monkeypatch.setattr(sys, "argv", ["release", "--out", str(tmp_path / "dist")])
    with pytest.raises(SystemExit, match="run `make docs` first"):
        command.main()


def test_a_release_with_a_known_flaw_is_refused(tmp_path):
    (tmp_path / "one.json").write_text(json.dumps(record("jinja2", {"introduced": "0"})))
    words = [*RELEASE, "--out", tmp_path / "dist", "--database", tmp_path]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "PYSEC-jinja2" in done.stderr
    assert not (tmp_path / "dist").exists()


@pytest.mark.full
def test_a_release_is_signed_and_its_sums_cover_every_file(tmp_path):
    key, out = SigningKey(tmp_path / "release.key"), tmp_path / "dist"
    key.load()
    done = subprocess.run(
        [*RELEASE, "--out", out, "--key", key.file],
        cwd=ROOT, env=os.environ | {"SOURCE_DATE_EPOCH": "1700000000"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    names = {file.name for file in out.iterdir()}
    version = boresight.__version__
    built = {
        f"boresight-{version}-py3-none-any.whl",
        f"boresight-{version}.tar.gz",
        "boresight.cdx.json",
        "LICENCES.md",
    }
    assert names == built | {"SHA256SUMS", "SHA256SUMS.sig"}
    sums = dict(reversed(line.split()) for line in (out / "SHA256SUMS").read_text().splitlines())
    assert sums == {name: hashlib.sha256((out / name).read_bytes()).hexdigest() for name in built}
    with zipfile.ZipFile(out / f"boresight-{version}-py3-none-any.whl") as wheel:
        metadata = wheel.read(f"boresight-{version}.dist-info/METADATA").decode()
    assert f"\nVersion: {version}\n" in metadata
    if openssl := shutil.which("openssl"):
        (tmp_path / "key.pem").write_text(key.list_public_keys()[0].pem)
        command = [openssl, "pkeyutl", "-verify", "-rawin", "-pubin", "-inkey", tmp_path / "key.pem"]
        command += ["-sigfile", out / "SHA256SUMS.sig", "-in", out / "SHA256SUMS"]
        assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    again = subprocess.run([*RELEASE, "--out", out], cwd=ROOT, capture_output=True, check=False)
    assert again.returncode == 1  # a folder that is not empty is left alone


def test_version_licence_and_authors_are_the_same_wherever_they_stand():
    citation = (ROOT / "CITATION.cff").read_text()
    assert "version" not in PROJECT  # the build takes it from `__version__`
    assert PROJECT["dynamic"] == ["version"]
    assert f"\nversion: {boresight.__version__}\n" in citation
    assert f"\nlicense: {PROJECT['license']}\n" in citation
    assert all(f"name: {author['name']}\n" in citation for author in PROJECT["authors"])
    assert PROJECT["authors"][0]["name"] in (ROOT / "LICENSE").read_text()
    changelog = (ROOT / "CHANGELOG.md").read_text()
    versions = re.findall(r"^## (\S+)$", changelog, re.MULTILINE)
    assert versions[0] == boresight.__version__
    assert set(versions[1:]) == set(RELEASED)  # what was released is what an upgrade is tested from
    released = re.search(r"^date-released: (\S+)$", citation, re.MULTILINE)[1]
    assert f"\n## {versions[0]}\n\n{released}. " in changelog
    assert f"Version {boresight.__version__}:" in (ROOT / "README.md").read_text()


def test_the_version_is_a_semantic_one_and_command_and_rest_say_it():
    assert re.fullmatch(r"[1-9]\d*\.\d+\.\d+", boresight.__version__)
    done = subprocess.run([sys.executable, "-m", "boresight", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"boresight, version {boresight.__version__}\n"
    assert OPENAPI["info"]["version"] == boresight.__version__


def test_the_classifiers_name_the_pythons_on_which_every_test_was_run():
    named = {one.rpartition(" ")[2] for one in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", one)}
    page = (ROOT / "docs" / "reference" / "versions.md").read_text()
    assert named == set(re.findall(r"^\| (3\.\d+) \| every test", page, re.MULTILINE))
    assert PROJECT["requires-python"] == f">={min(named)}"
