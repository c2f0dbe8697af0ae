"""Encrypted files: what is written is read, from any place, and nothing but what was written."""

import base64
import hashlib
import io
import os

import pytest
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from hypothesis import given
from hypothesis import strategies as st

from boresight.errors import NotFoundError, RefusedInputError
from boresight.platform.backups.encryption import (
    HEADER_BYTES,
    PIECE_BYTES,
    STORED_BYTES,
    DecryptedFile,
    EncryptingFile,
    KeyFile,
)


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> KeyFile:
    made = KeyFile(tmp_path_factory.mktemp("keys") / "backup.key")
    made.add()
    return made


def _encrypted(content: bytes, keys: KeyFile, portion: int = 10_000) -> bytes:
    target = io.BytesIO()
    writer = EncryptingFile(target, keys.first())
    for place in range(0, len(content), portion):
        writer.write(content[place : place + portion])
    writer.finish()
    return target.getvalue()


def _opened(stored: bytes, keys: KeyFile) -> DecryptedFile:
    return DecryptedFile(io.BytesIO(stored), keys)


@given(
    size=st.sampled_from([0, 1, PIECE_BYTES - 1, PIECE_BYTES, PIECE_BYTES + 1, 3 * PIECE_BYTES])
    | st.integers(0, 200_000),
    portion=st.integers(1000, 150_000),
    place=st.floats(0, 1),
    length=st.integers(0, 150_000),
)
def test_what_was_written_is_read_from_any_place(keys, size, portion, place, length):
    content = hashlib.shake_256(str(size).encode()).digest(size)
    file = _opened(_encrypted(content, keys, portion), keys)
    assert file.size == size
    start = int(place * size)
    assert file.seek(start) == start
    assert file.read(length) == content[start : start + length]
    file.seek(-min(7, size), os.SEEK_END)
    assert file.read() == content[max(size - 7, 0) :]


def test_the_format_is_the_documented_one(keys):
    content = bytes(range(256)) * 300
    stored = _encrypted(content, keys)
    secret = base64.b64decode(keys.file.read_text().split()[0])
    header, rest = stored[:64], stored[64:]
    assert header[:32] == b"BORESIGHT-ENC-1\n" + hashlib.sha256(b"boresight key" + secret).hexdigest()[:16].encode()
    key = HKDF(algorithm=SHA256(), length=32, salt=header[32:], info=header).derive(secret)
    pieces = [rest[place : place + 65_552] for place in range(0, len(rest), 65_552)]
    last = len(pieces) - 1
    plain = [
        AESGCM(key).decrypt(i.to_bytes(11, "big") + bytes([i == last]), piece, None) for i, piece in enumerate(pieces)
    ]
    assert b"".join(plain) == content


def _read(stored: bytes, keys: KeyFile) -> bytes:
    return _opened(stored, keys).read()


def test_every_change_is_refused(keys):
    content = os.urandom(3 * PIECE_BYTES + 5)
    stored = _encrypted(content, keys)
    first, second = (stored[HEADER_BYTES + i * STORED_BYTES :][:STORED_BYTES] for i in (0, 1))
    head, tail = stored[:HEADER_BYTES], stored[HEADER_BYTES + 2 * STORED_BYTES :]
    other = _encrypted(content, keys)
    changed = {
        "cut off in a piece": stored[:-1],
        "cut off after a piece": stored[: HEADER_BYTES + 3 * STORED_BYTES],
        "without its pieces": head,
        "pieces exchanged": head + second + first + tail,
        "a piece repeated": head + first + first + second + tail,
        "a piece left out": head + second + tail,
        "longer": stored + b"\0",
        "with another file's header": other[:HEADER_BYTES] + stored[HEADER_BYTES:],
    }
    for place in (40, HEADER_BYTES, HEADER_BYTES + STORED_BYTES + 9, len(stored) - 1):
        flipped = bytearray(stored)
        flipped[place] ^= 1
        changed[f"a bit at {place}"] = bytes(flipped)
    for what, altered in changed.items():
        with pytest.raises(RefusedInputError):
            raise AssertionError(f"{what}: {_read(altered, keys)[:1]!r}")
    assert _read(stored, keys) == content


def test_former_keys_still_read_and_a_key_that_is_gone_is_named(tmp_path):
    keys = KeyFile(tmp_path / "backup.key")
    with pytest.raises(NotFoundError):
        keys.first()
    former = keys.add()
    stored = _encrypted(b"before", keys)
    newer = keys.add()
    assert [key.id for key in keys.list_keys()] == [newer.id, former.id]
    assert _opened(stored, keys).key_id == former.id
    assert _read(stored, keys) == b"before"
    assert keys.file.stat().st_mode & 0o077 == 0
    keys.file.write_text(base64.b64encode(newer.secret).decode())
    with pytest.raises(NotFoundError, match=former.id):
        _opened(stored, keys)


@pytest.mark.parametrize("text", ["no key", "AAAA", "=" * 44])
def test_what_is_no_key_file_is_refused(tmp_path, text):
    (tmp_path / "k").write_text(text)
    with pytest.raises(RefusedInputError):
        KeyFile(tmp_path / "k").list_keys()
