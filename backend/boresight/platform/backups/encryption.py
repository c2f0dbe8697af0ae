"""Encrypted files: authenticated piece by piece, so that they are written as a stream and read from any place.

With K one of the keys of the key file, 32 bytes, and a salt of 32 random bytes for each file::

    file    = header || c_0 || c_1 || ... || c_n
    header  = "BORESIGHT-ENC-1" LF (16 bytes) || id of K (16) || salt (32)
    id of K = the first 16 hexadecimal digits of SHA-256("boresight key" || K)
    k       = HKDF-SHA-256(K, salt, info = header), 32 bytes
    c_i     = AES-256-GCM(k, nonce_i, p_i), its tag of 16 bytes at the end
    nonce_i = i in 11 bytes, the highest first || 1 for the last piece, 0 for the others

p_0 ... p_n are the plain bytes in pieces of 65,536, the last one shorter or as long; an empty file has one empty piece. This
is the STREAM construction of Hoang, Reyhanitabar, Rogaway and Vizár (2015) with a key of its own for each file: a piece that
is altered, exchanged, repeated or missing, the last ones too, is refused.

The key file has a key a line in base64, the one that encrypts first; those below it decrypt what they encrypted before.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import io
import os
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from boresight.disks import write_private
from boresight.errors import NotFoundError, RefusedInputError

if TYPE_CHECKING:
    from collections.abc import Buffer  # type: ignore[attr-defined]

MAGIC = b"BORESIGHT-ENC-1\n"
KEY_BYTES, ID_BYTES, SALT_BYTES, TAG_BYTES = 32, 16, 32, 16
HEADER_BYTES = len(MAGIC) + ID_BYTES + SALT_BYTES
PIECE_BYTES = 65_536
STORED_BYTES = PIECE_BYTES + TAG_BYTES


@dataclass(frozen=True)
class FileKey:
    """A key for files; its id stands in what it encrypted."""

    secret: bytes

    @property
    def id(self) -> str:
        """Its id, which does not tell the key."""
        return hashlib.sha256(b"boresight key" + self.secret).hexdigest()[:ID_BYTES]


class KeyFile:
    """The keys of a file outside the database; servers that share a schedule share it."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def list_keys(self) -> list[FileKey]:
        """Return the keys, the one that encrypts first; none where there is no file."""
        try:
            lines = [line.strip() for line in self.file.read_text().splitlines()]
        except FileNotFoundError:
            return []
        except (OSError, UnicodeDecodeError) as error:
            raise RefusedInputError(f"The key file {self.file} cannot be read ({error}): restore the file.") from error
        try:
            secrets_ = [base64.b64decode(line, validate=True) for line in lines if line and not line.startswith("#")]
        except binascii.Error:
            secrets_ = [b""]
        if any(len(one) != KEY_BYTES for one in secrets_):
            raise RefusedInputError(
                f"{self.file} is not a key file: give one key of 44 characters per line, unchanged."
            )
        return [FileKey(one) for one in secrets_]

    def first(self) -> FileKey:
        """Return the key that encrypts; refuses where there is none, for a new one would hide that the old one is lost."""
        keys = self.list_keys()
        if not keys:
            raise NotFoundError(
                f"There is no key in {self.file}: copy the key file there, or make one with `boresight backup rotate-key`."
            )
        return keys[0]

    def find(self, key_id: str) -> FileKey:
        """Return the key with an id."""
        for key in self.list_keys():
            if key.id == key_id:
                return key
        raise NotFoundError(
            f"{self.file} does not contain the key {key_id}, with which this backup is encrypted: copy the key file that does."
        )

    def add(self) -> FileKey:
        """Make a new key in first place; files of the former ones are still read."""
        known = self.list_keys()
        made = FileKey(secrets.token_bytes(KEY_BYTES))
        lines = [base64.b64encode(key.secret).decode() for key in (made, *known)]
        write_private(self.file, "\n".join([*lines, ""]))
        return made


def is_encrypted(file: BinaryIO) -> bool:
    """Whether a file begins as an encrypted one does; it is left at its beginning."""
    begins = file.read(len(MAGIC))
    file.seek(0)
    return begins == MAGIC


def _cipher(key: FileKey, header: bytes) -> AESGCM:
    salt = header[-SALT_BYTES:]
    return AESGCM(HKDF(algorithm=SHA256(), length=KEY_BYTES, salt=salt, info=header).derive(key.secret))


def _nonce(number: int, *, last: bool) -> bytes:
    return number.to_bytes(11, "big") + bytes([last])


class EncryptingFile(io.RawIOBase):
    """Encrypts what is written to it; until `finish` is called nobody can read it as a whole."""

    def __init__(self, target: BinaryIO, key: FileKey) -> None:
        header = MAGIC + key.id.encode() + os.urandom(SALT_BYTES)
        target.write(header)
        self._target = target
        self._cipher = _cipher(key, header)
        self._waiting = bytearray()
        self._number = 0

    def writable(self) -> bool:
        """It is written from its beginning to its end."""
        return True

    def write(self, content: Buffer, /) -> int:
        """Encrypt and write each piece that is full and not the last one."""
        self._waiting += content
        whole = max(len(self._waiting) - 1, 0) // PIECE_BYTES
        for place in range(0, whole * PIECE_BYTES, PIECE_BYTES):
            self._put(bytes(self._waiting[place : place + PIECE_BYTES]), last=False)
        del self._waiting[: whole * PIECE_BYTES]
        return len(memoryview(content))

    def finish(self) -> None:
        """Write the last piece."""
        self._put(bytes(self._waiting), last=True)
        self._waiting.clear()

    def _put(self, piece: bytes, *, last: bool) -> None:
        self._target.write(self._cipher.encrypt(_nonce(self._number, last=last), piece, None))
        self._number += 1


class SeekableFile(io.RawIOBase):
    """A file of `size` bytes that is read from any place."""

    size: int
    _place = 0

    def readable(self) -> bool:
        """It can be read."""
        return True

    def seekable(self) -> bool:
        """It can be read from any place."""
        return True

    def tell(self) -> int:
        """Return the place of the next byte."""
        return self._place

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Go to a place."""
        self._place = max(offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self.size}[whence], 0)
        return self._place


class DecryptedFile(SeekableFile):
    """Reads an encrypted file from any place; what is not as it was written is refused."""

    def __init__(self, source: BinaryIO, keys: KeyFile) -> None:
        self._source = source
        source.seek(0)
        header = bytes(source.read(HEADER_BYTES))
        if len(header) < HEADER_BYTES or not header.startswith(MAGIC):
            raise RefusedInputError("This file was not encrypted by Boresight, or was modified: use the original file.")
        self.key_id = header[len(MAGIC) :][:ID_BYTES].decode("ascii", "replace")
        self._cipher = _cipher(keys.find(self.key_id), header)
        stored = source.seek(0, os.SEEK_END) - HEADER_BYTES
        self._last = max(-(-stored // STORED_BYTES) - 1, 0)
        self._kept: tuple[int, bytes] = (-1, b"")
        self.size = stored - (self._last + 1) * TAG_BYTES
        self._piece(self._last)  # cut off anywhere, it is refused at once

    def _piece(self, number: int) -> bytes:
        if self._kept[0] != number:
            self._source.seek(HEADER_BYTES + number * STORED_BYTES)
            stored = bytes(self._source.read(STORED_BYTES))
            try:
                piece = self._cipher.decrypt(_nonce(number, last=number == self._last), stored, None)
            except InvalidTag as error:
                raise RefusedInputError(
                    "The encrypted file was altered, cut off or not written to its end: use another backup."
                ) from error
            self._kept = number, piece
        return self._kept[1]

    def readinto(self, buffer: Buffer, /) -> int:
        """Fill a buffer as far as the file goes."""
        view, filled = memoryview(buffer).cast("B"), 0
        while filled < len(view) and self._place < self.size:
            piece, offset = self._piece(self._place // PIECE_BYTES), self._place % PIECE_BYTES
            part = piece[offset : offset + len(view) - filled]
            view[filled : filled + len(part)] = part
            filled, self._place = filled + len(part), self._place + len(part)
        return filled
