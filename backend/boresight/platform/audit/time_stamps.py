"""Time-stamps by RFC 3161: a service outside the installation signs a hash together with the time.

The service sees a SHA-256 and a random number, never the content. Its answer is kept whole, and is verified when it comes and at
every verification after: against the certificates that the installation was given, as of the time in it, with the purpose
`timeStamping`, and that it is of this content. Without certificates nothing could be verified, so a service needs them.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from datetime import UTC

import httpx
from cryptography.x509 import Certificate, load_pem_x509_certificates
from rfc3161_client import (
    HashAlgorithm,
    TimestampRequestBuilder,
    TimeStampResponse,
    VerificationError,
    VerifierBuilder,
    decode_timestamp_response,
)

from boresight.errors import RefusedInputError, UnavailableError
from boresight.platform.db.times import utc_text

TIMEOUT_S = 10.0
LONGEST_ANSWER = 1 << 16
MEDIA_TYPE = "application/timestamp-query"


def read_certificates(pem: bytes, source: object) -> tuple[Certificate, ...]:
    """Read the certificates of the authorities that a time-stamp must lead back to."""
    try:
        return tuple(load_pem_x509_certificates(pem))
    except ValueError as error:
        raise RefusedInputError(
            f"{source} contains no certificate: give the PEM file of the time-stamp service's authorities."
        ) from error


@dataclass(frozen=True)
class TimeStamp:
    """An answer of a time-stamp service, as base64, and the time in it."""

    text: str
    at_utc: str


@dataclass(frozen=True)
class TimeStampService:
    """A service and the certificates that it is verified with."""

    url: str
    authorities: tuple[Certificate, ...]

    def stamp(self, content: bytes) -> TimeStamp:
        """Have a content stamped, and verify what came back."""
        asked = TimestampRequestBuilder().data(content).hash_algorithm(HashAlgorithm.SHA256).build()
        try:
            heard = self._ask(asked.as_bytes())
            answer = decode_timestamp_response(heard)
            verifier = VerifierBuilder(roots=list(self.authorities), nonce=asked.nonce).build()
            verifier.verify_message(answer, content)
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise UnavailableError(
                f"The time-stamp service {self.url} did not answer ({type(error).__name__}): check the address and the network.",
                code="no-answer",
            ) from error
        except (ValueError, VerificationError) as error:
            raise UnavailableError(
                f"The answer of the time-stamp service {self.url} is not a valid time-stamp ({error}): check the address, and "
                "that BORESIGHT_TIMESTAMP_CERTIFICATES names its authorities.",
                code="invalid-time-stamp",
            ) from error
        return TimeStamp(base64.b64encode(heard).decode(), _read_time(answer))

    def _ask(self, body: bytes) -> bytes:
        headers = {"Content-Type": MEDIA_TYPE, "Accept-Encoding": "identity"}
        with (
            httpx.Client(timeout=TIMEOUT_S, trust_env=False) as client,
            client.stream("POST", self.url, content=body, headers=headers) as answer,
        ):
            answer.raise_for_status()
            heard = b""
            for piece in answer.iter_raw():
                heard += piece
                if len(heard) > LONGEST_ANSWER:
                    raise ValueError(f"longer than {LONGEST_ANSWER} bytes")
            return heard


def read_time_stamp(text: str, content: bytes, authorities: tuple[Certificate, ...]) -> str | None:
    """Return the time in a stored answer; None where it is no valid time-stamp of this content."""
    try:
        answer = decode_timestamp_response(base64.b64decode(text, validate=True))
        VerifierBuilder(roots=list(authorities)).build().verify_message(answer, content)
        return _read_time(answer)
    except (ValueError, VerificationError):
        return None


def _read_time(answer: TimeStampResponse) -> str:
    return utc_text(answer.tst_info.gen_time.astimezone(UTC))
