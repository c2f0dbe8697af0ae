"""A person's authenticators in tests: an app that makes codes, and a security key that answers as WebAuthn describes."""

import hashlib
import json
import secrets
import struct
import time
from dataclasses import dataclass, field
from typing import Any

import cbor2
import httpx
import pyotp
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from webauthn.helpers import bytes_to_base64url

from tests.served import PASSWORD

PRESENT_AND_VERIFIED, WITH_CREDENTIAL = 0x05, 0x40


@dataclass
class App:
    """An authenticator app, whose clock a test can turn by steps of 30 s so that each code is a new one."""

    secret: str
    step: int = -1

    def code(self) -> str:
        """Return the next code that the server takes: three are taken at a time, each once."""
        self.step = max(self.step + 1, int(time.time()) // 30 - 1)
        assert self.step <= int(time.time()) // 30 + 1, "three codes were used within 30 s"
        return pyotp.TOTP(self.secret).generate_otp(self.step)


@dataclass
class SecurityKey:
    """A security key with one credential."""

    origin: str
    count: int = 0
    id: bytes = field(default_factory=lambda: secrets.token_bytes(32))
    key: Any = field(default_factory=lambda: ec.generate_private_key(ec.SECP256R1()))

    @property
    def name(self) -> str:
        return bytes_to_base64url(self.id)

    def _data(self, rp_id: str, flags: int) -> bytes:
        self.count += 1
        return hashlib.sha256(rp_id.encode()).digest() + struct.pack(">BI", flags, self.count)

    def _told(self, kind: str, challenge: str) -> bytes:
        return json.dumps({"type": kind, "challenge": challenge, "origin": self.origin, "crossOrigin": False}).encode()

    def _answer(self, told: bytes, **more: bytes) -> str:
        given = {name: bytes_to_base64url(value) for name, value in {"clientDataJSON": told, **more}.items()}
        return json.dumps({"id": self.name, "rawId": self.name, "type": "public-key", "response": given})

    def create(self, options: dict[str, Any]) -> str:
        point = self.key.public_key().public_numbers()
        cose = cbor2.dumps({1: 2, 3: -7, -1: 1, -2: point.x.to_bytes(32), -3: point.y.to_bytes(32)})
        data = self._data(options["rp"]["id"], PRESENT_AND_VERIFIED | WITH_CREDENTIAL)
        data += bytes(16) + struct.pack(">H", len(self.id)) + self.id + cose
        made = cbor2.dumps({"fmt": "none", "attStmt": {}, "authData": data})
        return self._answer(self._told("webauthn.create", options["challenge"]), attestationObject=made)

    def get(self, options: dict[str, Any]) -> str:
        told = self._told("webauthn.get", options["challenge"])
        data = self._data(options["rpId"], PRESENT_AND_VERIFIED)
        signature = self.key.sign(data + hashlib.sha256(told).digest(), ec.ECDSA(hashes.SHA256()))
        return self._answer(told, authenticatorData=data, signature=signature)


def enrol_app(client: httpx.Client, factor: str = "") -> tuple[App, list[str]]:
    """Enrol an authenticator app over REST; returns it with the recovery codes."""
    begun = client.post("/api/v1/second-factors:begin", json={"password": PASSWORD, "factor": factor})
    assert begun.status_code == 200, begun.text
    app = App(begun.json()["secret"])
    body = {"challenge_id": begun.json()["challenge_id"], "label": "Phone", "factor": app.code()}
    made = client.post("/api/v1/second-factors", json=body)
    assert made.status_code == 201, made.text
    return app, made.json()["recovery_codes"] or []


def enrol_key(client: httpx.Client, key: SecurityKey, factor: str = "") -> httpx.Response:
    """Enrol a security key over REST."""
    begun = client.post(
        "/api/v1/second-factors:begin", json={"kind": "webauthn", "password": PASSWORD, "factor": factor}
    )
    assert begun.status_code == 200, begun.text
    body = {"challenge_id": begun.json()["challenge_id"], "factor": key.create(begun.json()["options"])}
    return client.post("/api/v1/second-factors", json=body)
