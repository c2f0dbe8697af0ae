"""Links between server, scheduler and workers that prove who is at the other end.

Plain `tcp://` links ask nobody who they are: whoever reaches the scheduler's port can run code on every worker, so they belong on a
network of their own. With `tls://` both ends of each link show a certificate that the site's own authority has signed, and
everything on the way is encrypted. One certificate with its key in one file serves a machine in all its parts.
"""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit

from distributed import Security

from boresight.errors import RefusedInputError
from boresight.settings import Settings

PROTOCOL = "tls://"
PROTOCOLS = ("tcp://", PROTOCOL)


def refuse_unless_address(text: str) -> None:
    """Refuse what no scheduler can be asked at: it would be asked again for ever.

    Raises
    ------
    RefusedInputError
        When it is not `tcp://host:port` or `tls://host:port`.
    """
    try:
        parts = urlsplit(text)
        is_address = f"{parts.scheme}://" in PROTOCOLS and bool(parts.hostname) and bool(parts.port)
        is_address = is_address and not (parts.path or parts.query or parts.fragment or "@" in parts.netloc)
    except ValueError:  # a port over 65535, or no number
        is_address = False
    if not is_address:
        raise RefusedInputError(
            f"BORESIGHT_SCHEDULER={text!r} is no address of a scheduler: write tcp://host:port, or tls://host:port."
        )


def security_of(settings: Settings) -> Security | None:
    """Return what TLS links need, or None where links are plain.

    Raises
    ------
    RefusedInputError
        When the scheduler's address is none, when half of what TLS needs is missing, or a file cannot be read.
    """
    if settings.scheduler:
        refuse_unless_address(settings.scheduler)
    files = {"BORESIGHT_TLS_AUTHORITY": settings.tls_authority, "BORESIGHT_TLS_CERTIFICATE": settings.tls_certificate}
    if not any(files.values()):
        if settings.scheduler.startswith(PROTOCOL):
            raise RefusedInputError(
                f"{settings.scheduler} wants certificates: name them by BORESIGHT_TLS_AUTHORITY and BORESIGHT_TLS_CERTIFICATE."
            )
        return None
    for variable, path in files.items():
        if not path or not Path(path).is_file():
            raise RefusedInputError(f"{variable}={path!r} is no file: TLS links need the authority and a certificate.")
    if settings.scheduler and not settings.scheduler.startswith(PROTOCOL):
        raise RefusedInputError(
            f"There is a certificate, but BORESIGHT_SCHEDULER={settings.scheduler!r} is a plain link: write {PROTOCOL}."
        )
    certificate = {f"tls_{role}_cert": settings.tls_certificate for role in ("client", "scheduler", "worker")}
    return Security(tls_ca_file=settings.tls_authority, require_encryption=True, **certificate)
