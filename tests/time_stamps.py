"""A stand-in for a time-stamp service (RFC 3161): OpenSSL's own, an implementation apart from ours, behind a small HTTP server."""

import datetime as dt
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from benchmarks.servers import listening

CONFIGURATION = """
[tsa]
default_tsa = stand_in
[stand_in]
serial = {folder}/serial
signer_cert = {folder}/signer.pem
signer_key = {folder}/signer.key
signer_digest = sha256
default_policy = 1.3.6.1.4.1.4146.2.3
digests = sha256, sha512
accuracy = secs:1
ess_cert_id_chain = no
ess_cert_id_alg = sha256
"""
LIFE = dt.timedelta(days=30)


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _issue(folder: Path, name: str, issuer: tuple[x509.Name, ec.EllipticCurvePrivateKey] | None) -> tuple:
    key, now = ec.generate_private_key(ec.SECP256R1()), dt.datetime.now(dt.UTC)
    by, by_key = issuer or (_name(name), key)
    made = x509.CertificateBuilder(
        by, _name(name), key.public_key(), x509.random_serial_number(), now - LIFE, now + LIFE
    )
    made = made.add_extension(x509.BasicConstraints(ca=issuer is None, path_length=None), critical=True)
    if issuer is not None:
        usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.TIME_STAMPING])
        made = made.add_extension(usage, critical=True)
    pem = made.sign(by_key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
    (folder / f"{name}.pem").write_bytes(pem)
    form = (serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    (folder / f"{name}.key").write_bytes(key.private_bytes(*form))
    return _name(name), key


@dataclass
class StandIn:
    """The service: where it is, its authority's certificate, and what it does instead of its duty."""

    url: str
    authority: Path
    asked: list[bytes] = field(default_factory=list)
    instead: bytes | None = None


@contextmanager
def time_stamp_service(folder: Path) -> Iterator[StandIn]:
    if (openssl := shutil.which("openssl")) is None:
        pytest.skip("the stand-in of a time-stamp service is OpenSSL's, which is not here: apt-get install openssl")
    folder.mkdir(parents=True, exist_ok=True)
    _issue(folder, "signer", _issue(folder, "authority", None))
    (folder / "serial").write_text("01\n")
    (folder / "tsa.conf").write_text(CONFIGURATION.format(folder=folder))

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            asked = self.rfile.read(int(self.headers["Content-Length"]))
            stand_in.asked.append(asked)
            (folder / "query").write_bytes(asked)
            command = [openssl, "ts", "-reply", "-config", folder / "tsa.conf", "-section", "stand_in"]
            done = subprocess.run([*command, "-queryfile", folder / "query"], capture_output=True, check=True)
            answer = done.stdout if stand_in.instead is None else stand_in.instead
            self.send_response(200)
            self.send_header("Content-Type", "application/timestamp-reply")
            self.send_header("Content-Length", str(len(answer)))
            self.end_headers()
            self.wfile.write(answer)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    stand_in = StandIn(f"http://127.0.0.1:{server.server_port}/tsa", folder / "authority.pem")
    with listening(server):
        yield stand_in
