"""Authenticated links between server, scheduler and workers.

dask runs whatever function it is sent, so anybody who can use a link can do what the server can do: the key of the certificate is
the authorisation. Both ends of each link show a certificate that one authority has signed, and everything on the way is encrypted.

- Our own workers get a certificate from their server, made at each start and never written to a permanent file.
- With an external scheduler, one certificate with its key in one file serves a machine in all its parts.
- Plain `tcp://` links ask nobody who they are. Off this machine they are refused, unless a setting says that nobody else is on
  that network; on this machine they are open to all of its users.

Certificates for the links between server, scheduler and workers.

An authority is made for one certificate and its key is forgotten, so nobody, not even who made it, can sign a second one: whoever
holds the one key is a part of this cluster, and nobody else is.
"""

from __future__ import annotations

import logging
import ssl
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from urllib.parse import urlsplit

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509 import load_pem_x509_certificates
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from distributed import Security

from boresight.errors import RefusedInputError
from boresight.hosts import is_loopback
from boresight.settings import Settings

#: "No well-defined expiration date" (RFC 5280, 4.1.2.5), and a beginning that no clock stands before.
NEVER = datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC)
ALWAYS = datetime(1970, 1, 1, tzinfo=UTC)
HASH = hashes.SHA256()


@dataclass(frozen=True, repr=False)
class IssuedCertificates:
    """An authority and the one certificate it has signed, with the certificate's key, each as PEM."""

    authority: str
    certificate: str
    key: str


def issue(begins: datetime = ALWAYS, ends: datetime = NEVER) -> IssuedCertificates:
    """Sign one certificate, for both ends of a link, by an authority whose key is forgotten."""
    authority_key, key = ec.generate_private_key(ec.SECP256R1()), ec.generate_private_key(ec.SECP256R1())
    authority_name, name = _named("Boresight authority"), _named("Boresight")
    signer = x509.SubjectKeyIdentifier.from_public_key(authority_key.public_key())
    authority = (
        _builder(authority_name, authority_name, authority_key.public_key(), begins, ends)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs_certificates=True), critical=True)
        .add_extension(signer, critical=False)
        .sign(authority_key, HASH)
    )
    certificate = (
        _builder(name, authority_name, key.public_key(), begins, ends)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs_certificates=False), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]), critical=False
        )
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(signer), critical=False)
        .sign(authority_key, HASH)
    )
    return IssuedCertificates(
        authority.public_bytes(Encoding.PEM).decode(),
        certificate.public_bytes(Encoding.PEM).decode(),
        key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode(),
    )


def _named(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, begins: datetime, ends: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(begins)
        .not_valid_after(ends)
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )


log = logging.getLogger(__name__)

PROTOCOL = "tls://"
PROTOCOLS = ("tcp://", PROTOCOL)
ANYBODY_READS = 0o004
WARN_BEFORE = timedelta(days=30)
MAKE_NEW = "make new ones with `boresight certificates`, and restart server, scheduler and workers"


def refuse_unless_address(text: str) -> None:
    """Refuse an invalid address of a scheduler, which would be tried forever."""
    try:
        parts = urlsplit(text)
        is_address = f"{parts.scheme}://" in PROTOCOLS and bool(parts.hostname) and bool(parts.port)
        is_address = is_address and not (parts.path or parts.query or parts.fragment or "@" in parts.netloc)
    except ValueError:  # a port over 65535, or no number
        is_address = False
    if not is_address:
        raise RefusedInputError(
            f"BORESIGHT_SCHEDULER={text!r} is not the address of a scheduler: write tcp://host:port, or tls://host:port.",
            code="not-an-address",
        )


def own_security() -> Security:
    """Return TLS for the workers of this process, which get its key through the pipe that starts them."""
    made = issue()
    roles = ("client", "scheduler", "worker")
    return Security(
        require_encryption=True,
        tls_min_version=ssl.TLSVersion.TLSv1_3,
        tls_ca_file=made.authority,
        **{f"tls_{role}_cert": made.certificate for role in roles},
        **{f"tls_{role}_key": made.key for role in roles},
    )


def refuse_open_link(settings: Settings, host: str, given: str) -> None:
    """Refuse a plain link that is reachable from other machines."""
    if settings.cluster_network_closed or is_loopback(host):
        return
    raise RefusedInputError(
        f"{given} is a plain link to another machine; anyone who can reach it can run programs on the server and on every worker: "
        f"create certificates and use {PROTOCOL} (BORESIGHT_TLS_AUTHORITY and BORESIGHT_TLS_CERTIFICATE), or, if nobody else is "
        "on that network, set BORESIGHT_CLUSTER_NETWORK_CLOSED=1.",
        code="plain-link",
    )


def make_security(settings: Settings) -> Security | None:
    """Return what TLS links need, or None where links are plain."""
    if settings.scheduler:
        refuse_unless_address(settings.scheduler)
    files = {"BORESIGHT_TLS_AUTHORITY": settings.tls_authority, "BORESIGHT_TLS_CERTIFICATE": settings.tls_certificate}
    if not any(files.values()):
        if settings.scheduler.startswith(PROTOCOL):
            raise RefusedInputError(
                f"{settings.scheduler} needs certificates: name them by BORESIGHT_TLS_AUTHORITY and BORESIGHT_TLS_CERTIFICATE.",
                code="no-certificates",
            )
        if settings.scheduler:
            host = urlsplit(settings.scheduler).hostname or ""
            refuse_open_link(settings, host, f"BORESIGHT_SCHEDULER={settings.scheduler}")
        return None
    for variable, path in files.items():
        if not path or not Path(path).is_file():
            raise RefusedInputError(
                f"{variable}={path!r} is not a file: make authority and certificate with `boresight certificates`."
            )
    if settings.scheduler and not settings.scheduler.startswith(PROTOCOL):
        raise RefusedInputError(
            f"There is a certificate, but BORESIGHT_SCHEDULER={settings.scheduler!r} is a plain link: write {PROTOCOL}."
        )
    _refuse_unusable(settings)
    certificate = {f"tls_{role}_cert": settings.tls_certificate for role in ("client", "scheduler", "worker")}
    return Security(tls_ca_file=settings.tls_authority, require_encryption=True, **certificate)


def _refuse_unusable(settings: Settings) -> None:
    """Refuse unusable files and a key that any user of this machine can read; warn of an expiry that is near."""
    given = f"BORESIGHT_TLS_CERTIFICATE={settings.tls_certificate!r}"
    try:
        load_pem_x509_certificates(Path(settings.tls_authority).read_bytes())
    except (OSError, ValueError) as error:
        raise RefusedInputError(
            f"BORESIGHT_TLS_AUTHORITY={settings.tls_authority!r} contains no readable certificate (PEM): {MAKE_NEW}.",
            code="unreadable-certificate",
        ) from error
    path = Path(settings.tls_certificate)
    try:
        pem = path.read_bytes()
        certificate = load_pem_x509_certificates(pem)[0]
        load_pem_private_key(pem, password=None)
    except (OSError, TypeError, ValueError) as error:
        raise RefusedInputError(
            f"{given} does not contain a certificate and its key (PEM, no pass phrase): {MAKE_NEW}."
        ) from error
    if path.stat().st_mode & ANYBODY_READS:
        raise RefusedInputError(
            f"{given} can be read by every user of this machine, and its key lets them run programs here: chmod 600 it."
        )
    left = certificate.not_valid_after_utc - datetime.now(UTC)
    if left < timedelta(0):
        raise RefusedInputError(f"{given} has expired on {certificate.not_valid_after_utc:%Y-%m-%d}: {MAKE_NEW}.")
    if left < WARN_BEFORE:
        log.warning("%s expires on %s: %s before.", given, f"{certificate.not_valid_after_utc:%Y-%m-%d}", MAKE_NEW)
