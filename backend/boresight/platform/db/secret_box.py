"""Secrets in the database that are readable only with a key outside it.

With the first line k of the key file, a Fernet key (AES-128-CBC and HMAC-SHA256)::

    stored = "fernet:" + Fernet(k).encrypt(secret)

The file is made when there is first something to encrypt, readable by its owner alone; it is in no backup. Further lines
are keys of before, with which what they encrypted can still be read. Several servers on one database share the file.
"""

from __future__ import annotations

from pathlib import Path

from cryptography.fernet import Fernet, InvalidToken, MultiFernet

from boresight.disks import write_private
from boresight.errors import RefusedInputError

SEALED = "fernet:"


def is_sealed(stored: str) -> bool:
    """Whether a secret is stored encrypted."""
    return stored.startswith(SEALED)


class SecretBox:
    """Encrypts and decrypts what the database keeps for later use."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._read: tuple[int, MultiFernet] | None = None

    def seal(self, secret: str) -> str:
        """Encrypt a secret with the newest key, which is made when there is none yet."""
        keys = self._keys()
        if keys is None:
            write_private(self.file, f"{Fernet.generate_key().decode()}\n", replace=False)
            keys = self._keys()
        if keys is None:
            raise self._unusable()
        return SEALED + keys.encrypt(secret.encode()).decode()

    def open(self, stored: str | None) -> str | None:
        """Decrypt a secret; None without a secret or without its key. A secret of an older version is plain."""
        if stored is None or not is_sealed(stored):
            return stored
        keys = self._keys()
        if keys is None:
            return None
        try:
            return keys.decrypt(stored.removeprefix(SEALED)).decode()
        except InvalidToken:
            return None

    def renew(self, stored: str | None) -> str | None:
        """Encrypt a stored secret with the newest key; None without a secret or without its key."""
        secret = self.open(stored)
        return None if secret is None else self.seal(secret)

    def add_key(self) -> None:
        """Add a new key in first place; secrets encrypted with older keys remain readable."""
        self._keys()  # refuse an unreadable file before it is overwritten
        known = self._lines() if self.file.exists() else []
        write_private(self.file, "\n".join([Fernet.generate_key().decode(), *known, ""]))

    def forget_old_keys(self) -> int:
        """Keep the newest key only; return how many were forgotten."""
        known = self._lines() if self.file.exists() else []
        if len(known) > 1:
            write_private(self.file, f"{known[0]}\n")
        return max(len(known) - 1, 0)

    def _keys(self) -> MultiFernet | None:
        """Return the keys in the file, None where there is no file."""
        try:
            changed = self.file.stat().st_mtime_ns
        except FileNotFoundError:
            return None
        if self._read is None or self._read[0] != changed:
            try:
                self._read = changed, MultiFernet([Fernet(line) for line in self._lines()])
            except ValueError as error:
                raise self._unusable() from error
        return self._read[1]

    def _lines(self) -> list[str]:
        lines = (line.strip() for line in self.file.read_text().splitlines())
        return [line for line in lines if line and not line.startswith("#")]

    def _unusable(self) -> RefusedInputError:
        return RefusedInputError(
            f"{self.file} contains no usable key: restore the file, or remove it and give each webhook a new secret.",
            code="unusable-key",
        )
