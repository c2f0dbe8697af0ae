"""Ed25519 signatures (RFC 8032) of an installation, by a private key that neither database nor backup holds.

The key is a PEM file that its owner alone can read, made when something is first signed, or the text of the setting itself::

    -----BEGIN PRIVATE KEY-----      signs; there is one
    -----BEGIN PUBLIC KEY-----       former keys, newest first: they verify, and can sign no more

    id(key) = the first 16 hexadecimal digits of SHA-256(the 32 bytes of the public key)

A rotation puts a new private key in front and keeps only what is public of the former one. Several servers on one database
share the file. Whoever reads it can sign as this installation, so public keys belong where signatures are verified.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from boresight.disks import write_private
from boresight.errors import RefusedInputError, UnavailableError

BLOCK = re.compile(r"-----BEGIN ([A-Z ]+)-----.*?-----END \1-----", re.DOTALL)
PEM_BEGINS = "-----BEGIN"
OTHERS = 0o077  # everybody but the owner
ID_DIGITS = 16
KEY_BYTES = 32


@dataclass(frozen=True)
class PublicKey:
    """A public key, by its 32 bytes."""

    raw: bytes

    @classmethod
    def decode(cls, text: str) -> PublicKey:
        """Read a key from base64."""
        raw = base64.b64decode(text, validate=True)
        if len(raw) != KEY_BYTES:
            raise ValueError(f"Expected {KEY_BYTES} bytes / Received {len(raw)}")
        return cls(raw)

    @property
    def id(self) -> str:
        """The key's id."""
        return hashlib.sha256(self.raw).hexdigest()[:ID_DIGITS]

    @property
    def text(self) -> str:
        """The key as base64."""
        return base64.b64encode(self.raw).decode()

    @property
    def pem(self) -> str:
        """The key as PEM."""
        encoding, form = serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
        return Ed25519PublicKey.from_public_bytes(self.raw).public_bytes(encoding, form).decode()

    def verifies(self, signature: str, content: bytes) -> bool:
        """Whether a signature, as base64, is this key's of a content."""
        try:
            Ed25519PublicKey.from_public_bytes(self.raw).verify(base64.b64decode(signature, validate=True), content)
        except (InvalidSignature, ValueError):
            return False
        return True


@dataclass(frozen=True)
class Signer:
    """A private key that was read, and its public half."""

    private: Ed25519PrivateKey

    @property
    def public(self) -> PublicKey:
        """The public key."""
        return PublicKey(self.private.public_key().public_bytes_raw())

    def sign(self, content: bytes) -> str:
        """Return the detached signature of a content, as base64."""
        return base64.b64encode(self.private.sign(content)).decode()


def read_public_keys(text: str, source: object) -> tuple[PublicKey, ...]:
    """Read the public keys of a PEM file."""
    try:
        keys = tuple(_public(block[0]) for block in BLOCK.finditer(text) if block[1] == "PUBLIC KEY")
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise RefusedInputError(f"{source} contains a public key that is not Ed25519: remove it.") from error
    if not keys:
        raise RefusedInputError(f"{source} contains no public key: give a PEM file from `boresight audit keys`.")
    return keys


def _public(pem: str) -> PublicKey:
    key = serialization.load_pem_public_key(pem.encode())
    if not isinstance(key, Ed25519PublicKey):
        raise TypeError("Expected an Ed25519 key / Received another kind")
    return PublicKey(key.public_bytes_raw())


def _private(pem: str) -> Ed25519PrivateKey:
    key = serialization.load_pem_private_key(pem.encode(), None)
    if not isinstance(key, Ed25519PrivateKey):
        raise TypeError("Expected an Ed25519 key / Received another kind")
    return key


def _spelled(key: Ed25519PrivateKey) -> str:
    encoding, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    return key.private_bytes(encoding, form, serialization.NoEncryption()).decode()


class SigningKey:
    """The signing key of an installation and the public keys of those before it; read at each use, so a rotation counts at once."""

    def __init__(self, place: str | Path) -> None:
        self._text = place if isinstance(place, str) else None
        self.file = place if isinstance(place, Path) else None

    @property
    def name(self) -> str:
        """Where the key is, for sentences."""
        return "BORESIGHT_SIGNING_KEY" if self.file is None else str(self.file)

    def load(self) -> Signer:
        """Read the key, which is made when there is none yet."""
        return self._read(make=True)[0]

    def list_public_keys(self) -> tuple[PublicKey, ...]:
        """Return the public keys, the present one first; none where nothing was signed yet."""
        if self.file is not None and not self.file.exists():
            return ()
        signer, former = self._read(make=False)
        return (signer.public, *former)

    def rotate(self) -> PublicKey:
        """Make a new key in place of the present one, of which only the public half is kept."""
        known = self.list_public_keys()
        signer = Signer(Ed25519PrivateKey.generate())
        self._write(signer, known)
        return signer.public

    def trust(self, key: PublicKey) -> None:
        """Add the public key of a lost private key, so that what it signed verifies again."""
        signer, former = self._read(make=True)
        if key not in {signer.public, *former}:
            self._write(signer, (*former, key))

    def _write(self, signer: Signer, former: Sequence[PublicKey]) -> None:
        if self.file is None:
            raise RefusedInputError(
                "BORESIGHT_SIGNING_KEY contains the key itself: put the new keys into the setting, or let it name a file."
            )
        write_private(self.file, "".join([_spelled(signer.private), *(key.pem for key in former)]))

    def _read(self, *, make: bool) -> tuple[Signer, tuple[PublicKey, ...]]:
        if make and self.file is not None and not self.file.exists():
            write_private(self.file, _spelled(Ed25519PrivateKey.generate()), replace=False)
        blocks = list(BLOCK.finditer(self._read_text()))
        try:
            (private,) = (_private(block[0]) for block in blocks if block[1] == "PRIVATE KEY")
            return Signer(private), tuple(_public(block[0]) for block in blocks if block[1] == "PUBLIC KEY")
        except (ValueError, TypeError, UnsupportedAlgorithm) as error:
            raise RefusedInputError(
                f"{self.name} contains no usable Ed25519 key: restore it, or remove it and let a new key be made.",
                code="unusable-key",
            ) from error

    def _read_text(self) -> str:
        if self.file is None:
            return self._text or ""
        try:
            if self.file.stat().st_mode & OTHERS:
                raise RefusedInputError(
                    f"Other users can read the signing key {self.file}: run chmod 600 on it, and rotate it if somebody may have."
                )
            return self.file.read_text()
        except OSError as error:
            raise UnavailableError(
                f"The signing key {self.file} cannot be read ({error.strerror}): let the user of this process read it."
            ) from error
