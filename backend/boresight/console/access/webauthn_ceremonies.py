"""WebAuthn (W3C Level 2): the options that a browser is given, and the check of what an authenticator signed.

A credential belongs to one site, its relying party id, which is the host that people type; the browser refuses it to any
other. No attestation is asked for: which make a key is of decides nothing here.
"""

from __future__ import annotations

import hashlib
import ipaddress
import json
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from urllib.parse import urlsplit

import webauthn
from webauthn.helpers import (
    base64url_to_bytes,
    bytes_to_base64url,
    options_to_json,
    parse_authentication_credential_json,
    parse_client_data_json,
)
from webauthn.helpers.exceptions import WebAuthnException
from webauthn.helpers.structs import (
    AuthenticatorSelectionCriteria,
    PublicKeyCredentialDescriptor,
    ResidentKeyRequirement,
    UserVerificationRequirement,
)

from boresight.console.access.tables import SecondFactor, User
from boresight.errors import RefusedInputError, SecondFactorError

CHALLENGE_BYTES = 32
WAIT_MS = 120_000
LONGEST_ANSWER = 8_000  # characters; one is about 1,000, with an attestation some more
LONGEST_CREDENTIAL = 1_023  # bytes (WebAuthn, 4)
NO_ANSWER = "The answer of the security key cannot be read; reload the page and try again."
MALFORMED = (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError)


@dataclass(frozen=True)
class RelyingParty:
    """The site that credentials belong to: its host, and the origin that browsers write."""

    rp_id: str
    origin: str

    @classmethod
    def of(cls, address: str) -> RelyingParty:
        """Return the site of a server's address."""
        parts = urlsplit(address)
        return cls(parts.hostname or "", f"{parts.scheme}://{parts.netloc}")

    def refuse_address(self) -> None:
        """Refuse a site without a name, which no browser takes."""
        try:
            ipaddress.ip_address(self.rp_id)
        except ValueError:
            return
        raise RefusedInputError(
            f"Security keys need a host name and not the address {self.rp_id}: open this server by its name, or on its own machine "
            "as localhost."
        )


@dataclass(frozen=True)
class RegisteredCredential:
    """What an authenticator registered."""

    credential_id: str
    public_key: str
    sign_count: int


def new_challenge() -> str:
    """Return random bytes in base64url."""
    return secrets.token_urlsafe(CHALLENGE_BYTES)


@contextmanager
def _refusing(answer: str, sentence: str) -> Iterator[None]:
    """Refuse an answer that is too long, or that the library finds wrong or cannot read."""
    if len(answer) > LONGEST_ANSWER:
        raise SecondFactorError(NO_ANSWER)
    try:
        yield
    except (WebAuthnException, *MALFORMED) as error:
        raise SecondFactorError(sentence) from error


def make_creation_options(user: User, known: Sequence[SecondFactor], challenge: str, site: RelyingParty) -> str:
    """Return the options of `navigator.credentials.create` as JSON."""
    site.refuse_address()
    options = webauthn.generate_registration_options(
        rp_id=site.rp_id,
        rp_name="Boresight",
        user_id=hashlib.sha256(f"boresight user {user.id}".encode()).digest(),
        user_name=user.name,
        user_display_name=user.printed_name,
        challenge=base64url_to_bytes(challenge),
        timeout=WAIT_MS,
        authenticator_selection=AuthenticatorSelectionCriteria(
            resident_key=ResidentKeyRequirement.DISCOURAGED, user_verification=UserVerificationRequirement.PREFERRED
        ),
        exclude_credentials=_describe(_list_own(known, site)),
    )
    return options_to_json(options)


def make_request_options(known: Sequence[SecondFactor], challenge: str, site: RelyingParty) -> str | None:
    """Return the options of `navigator.credentials.get` as JSON; None where no key of this site is known."""
    own = _list_own(known, site)
    if not own:
        return None
    options = webauthn.generate_authentication_options(
        rp_id=site.rp_id,
        challenge=base64url_to_bytes(challenge),
        timeout=WAIT_MS,
        allow_credentials=_describe(own),
        user_verification=UserVerificationRequirement.PREFERRED,
    )
    return options_to_json(options)


def _list_own(known: Sequence[SecondFactor], site: RelyingParty) -> list[str]:
    """Return the credentials of a site."""
    return [one.credential_id for one in known if one.credential_id is not None and one.rp_id == site.rp_id]


def _describe(credentials: Sequence[str]) -> list[PublicKeyCredentialDescriptor]:
    return [PublicKeyCredentialDescriptor(id=base64url_to_bytes(one)) for one in credentials]


def check_registration(answer: str, challenge: str, site: RelyingParty) -> RegisteredCredential:
    """Check what `navigator.credentials.create` returned."""
    unfit = "The security key was not registered, for its answer does not fit this page; reload the page and try again."
    with _refusing(answer, unfit):
        made = webauthn.verify_registration_response(
            credential=answer,
            expected_challenge=base64url_to_bytes(challenge),
            expected_rp_id=site.rp_id,
            expected_origin=site.origin,
        )
    if len(made.credential_id) > LONGEST_CREDENTIAL:
        raise SecondFactorError(NO_ANSWER)
    return RegisteredCredential(
        bytes_to_base64url(made.credential_id), bytes_to_base64url(made.credential_public_key), made.sign_count
    )


@dataclass(frozen=True)
class Assertion:
    """An answer of `navigator.credentials.get`, not yet checked: the credential and the challenge that it names."""

    answer: str
    credential_id: str
    challenge: str


def read_assertion(answer: str) -> Assertion:
    """Read which credential and which challenge an answer names."""
    with _refusing(answer, NO_ANSWER):
        given = parse_authentication_credential_json(json.loads(answer))
        told = parse_client_data_json(given.response.client_data_json)
        return Assertion(answer, bytes_to_base64url(given.raw_id), bytes_to_base64url(told.challenge))


def check_assertion(given: Assertion, challenge: str, site: RelyingParty, public_key: str, sign_count: int) -> int:
    """Check an answer against a challenge and a public key; returns the new count of signatures."""
    other = (
        "The security key's answer was refused: it is of another key, page or attempt; reload the page and try again."
    )
    with _refusing(given.answer, other):
        checked = webauthn.verify_authentication_response(
            credential=given.answer,
            expected_challenge=base64url_to_bytes(challenge),
            expected_rp_id=site.rp_id,
            expected_origin=site.origin,
            credential_public_key=base64url_to_bytes(public_key),
            credential_current_sign_count=sign_count,
        )
    return checked.new_sign_count
