"""The export of the audit log: whoever holds it needs nothing but Python to know that no byte of it moved."""

import hashlib
import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import RefusedInputError
from boresight.platform.actors import SYSTEM, Policy
from boresight.platform.audit import chain
from boresight.platform.audit import log as audit
from boresight.platform.audit.audit_verifier import canonical, compute_hash, verify
from boresight.platform.audit.export import verifier, write_export
from boresight.platform.db.sessions import Engine, open_reading, open_writing

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
def log(engine: Engine) -> Engine:
    with open_writing(engine) as session:
        audit.append(session, SYSTEM, "counted", "numbers/1", None, {"ψ": 1e22, "σ": [0.1, -0.0, None]}, 'a "reason"\n')
        audit.append(session, SYSTEM, "counted", "numbers/2", {"n": 1}, {"n": 2})
    return engine


def _head(engine: Engine) -> str:
    with open_reading(engine) as session:
        return audit.head(session)


def test_an_export_verifies_and_tells_the_head_of_the_log(log: Engine) -> None:
    good, sentence = verify(io.BytesIO(_export(log)))
    assert good, sentence
    assert f"head {_head(log)}" in sentence


def test_any_flipped_bit_is_found(log: Engine) -> None:
    whole, chosen = _export(log), np.random.default_rng(1)
    for place in range(len(whole)):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << int(chosen.integers(8))
        good, sentence = verify(io.BytesIO(bytes(flipped)))
        assert not good, (place, sentence)


@pytest.mark.parametrize("cut", [0, 1, 2])
def test_a_record_that_is_missing_moved_or_repeated_is_found(log: Engine, cut: int) -> None:
    lines = _export(log).splitlines(keepends=True)
    without = lines[:cut] + lines[cut + 1 :]
    exchanged = [*lines[:cut], lines[cut + 1], lines[cut], *lines[cut + 2 :]]
    twice = [*lines[: cut + 1], *lines[cut:]]
    for changed in (without, exchanged, twice, lines[: cut + 1], [*lines, lines[cut]]):
        assert not verify(io.BytesIO(b"".join(changed)))[0]


def test_a_chain_rebuilt_from_an_edit_on_is_found_only_with_a_head_from_before(log: Engine) -> None:
    lines = _export(log).splitlines()
    records = [json.loads(line) for line in lines[:-1]]
    records[0]["actor"] = "Mallory"
    previous = chain.FIRST_HASH
    for record in records:
        record["previous_hash"], record["hash"] = previous, compute_hash(previous, record)
        previous = record["hash"]
    body = b"".join(f"{canonical(record)}\n".encode() for record in records)
    last = json.loads(lines[-1]) | {"head": previous}
    del last["sha256"]
    last["sha256"] = hashlib.sha256(body + canonical(last).encode()).hexdigest()
    forged = body + f"{canonical(last)}\n".encode()
    assert verify(io.BytesIO(forged))[0]
    good, sentence = verify(io.BytesIO(forged), _head(log))
    assert not good
    assert "rewritten" in sentence


@pytest.mark.parametrize("first", [0, 3, -1])
def test_records_renumbered_in_the_database_are_found_in_its_export(log: Engine, first: int) -> None:
    lines = _export(log).splitlines()
    records = [json.loads(line) for line in lines[:-1]]
    for record in records[first:]:
        record["id"] += 1000  # outside the hash of a record
    good, sentence = verify(io.BytesIO(_exported(records, lines[-1])), _head(log))
    line = range(1, len(records) + 1)[first]
    assert (good, f"Line {line} is not as it was written" in sentence) == (False, True), sentence


def test_a_gap_is_let_pass_before_a_record_of_an_older_version_only(log: Engine) -> None:
    lines, previous = _export(log).splitlines(), chain.FIRST_HASH
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


def test_the_program_in_the_zip_runs_without_boresight_and_finds_a_flipped_byte(log: Engine, tmp_path: Path) -> None:
    with zipfile.ZipFile(io.BytesIO(_export(log, "zip"))) as archive:
        archive.extractall(tmp_path)
    assert (tmp_path / "verify_audit.py").read_text() == verifier()
    good = _bare(tmp_path, "--head", _head(log))
    assert (good.returncode, "records are as they were written" in good.stdout) == (0, True), good.stderr
    whole = bytearray((tmp_path / "audit.jsonl").read_bytes())
    whole[len(whole) // 3] ^= 1
    (tmp_path / "audit.jsonl").write_bytes(whole)
    bad = _bare(tmp_path)
    assert (bad.returncode, "is not as it was written" in bad.stderr) == (1, True)


def _bare(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-I", "-S", "verify_audit.py", "audit.jsonl", *options]
    return subprocess.run(command, cwd=folder, env={}, capture_output=True, text=True, check=False)


def test_the_last_line_says_whether_four_eyes_are_enforced(log: Engine) -> None:
    for policy in (Policy(), Policy(four_eyes=False)):
        assert json.loads(_export(log, policy=policy).splitlines()[-1])["four_eyes"] is policy.four_eyes


def test_another_form_is_refused(log: Engine) -> None:
    with pytest.raises(RefusedInputError, match="zip or jsonl"):
        _export(log, "xml")


@given(after=st.none() | st.dictionaries(st.text(max_size=8), JSON), text=st.text(), number=st.none() | st.integers())
def test_the_store_and_the_verifier_hash_every_record_alike(after: Any, text: str, number: int | None) -> None:
    record = dict.fromkeys(chain.COLUMNS) | {"after": after, "actor_id": number, "id": 1}
    record |= {name: text for name in chain.TEXTS if name not in ("reason", "request_id")}
    raw = record | {"after": None if after is None else canonical(after)}
    assert chain.compute_hash(chain.FIRST_HASH, raw) == compute_hash(chain.FIRST_HASH, record)
    assert chain.spelled(raw | {"hash": "h", "previous_hash": "p"}) == canonical(
        record | {"hash": "h", "previous_hash": "p"}
    )
