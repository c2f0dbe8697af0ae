"""Every setting in one table: name, default, unit, sentence. Read once at a door and passed down as a value."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from urllib.parse import urlsplit

from boresight.errors import RefusedInputError
from boresight.platform.actors import Policy, SessionLimits
from boresight.platform.audit.external_head import refuse_place
from boresight.platform.blobs.locations import BlobLocation, parse_address
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.web.targets import WebhookTargets, read_hosts
from boresight.telemetry.read.limits import Limits

log = logging.getLogger(__name__)

OTHERS = 0o077  # everybody but the owner


@dataclass(frozen=True)
class Setting:
    """One row of the table; `read` turns the environment's text into the value."""

    name: str
    default: str
    unit: str
    sentence: str
    read: Callable[[str], object]

    @property
    def variable(self) -> str:
        """Name of the environment variable."""
        return f"BORESIGHT_{self.name.upper()}"


def _site(text: str) -> str:
    """Read the address of a site: empty, or a scheme and a host."""
    parts = urlsplit(text)
    if text and (parts.scheme not in {"http", "https"} or not parts.hostname or parts.port == 0):
        raise ValueError(text)
    return text


SETTINGS = (
    Setting("data_folder", "", "path", "Database, blobs, catalogue, compiled kernels; empty = your data folder.", str),
    Setting("database_url", "", "URL", "SQLAlchemy address of the store; empty = SQLite in the data folder.", str),
    Setting("blobs", "", "path or URL", "Folder of files, or s3://bucket/prefix; empty = in the data folder.", str),
    Setting("blob_cache_mb", "10240", "MB", "Files of an object store kept here; the least used go.", float),
    Setting("host", "127.0.0.1", "address", "Address the server listens on.", str),
    Setting("port", "8000", "", "Port the server listens on.", int),
    Setting("trusted_proxies", "127.0.0.1", "addresses", "Proxies whose X-Forwarded-For and -Proto count.", str),
    Setting(
        "public_url", "", "URL", "Where people find the server, if a proxy hides it; empty = what Host says.", _site
    ),
    Setting("mode", "OPS", "", "Tag in the top bar: OPS, SIM or TRAINING.", str),
    Setting("scheduler", "", "address", "Dask scheduler, tls://host:port; empty = our own worker processes.", str),
    Setting(
        "tls_authority", "", "path", "Authority (PEM) that signed every machine's certificate, for tls:// links.", str
    ),
    Setting(
        "tls_certificate", "", "path", "This machine's certificate and key in one PEM file, for tls:// links.", str
    ),
    Setting(
        "cluster_network_closed",
        "0",
        "0 or 1",
        "1 = plain tcp:// links may leave this machine: nobody else is on their network.",
        int,
    ),
    Setting("workers", "2", "processes", "Worker processes started when no scheduler is given; 0 = none here.", int),
    Setting(
        "threads", "0", "threads", "Threads a command computes on, 0 = one a core; worker processes use one each.", int
    ),
    Setting("lease_s", "10", "s", "How long a run belongs to the server that claimed it without a renewal.", float),
    Setting("max_attempts", "3", "", "After so many lost attempts a run is FAILED as poison.", int),
    Setting("upload_limit_mb", "512", "MB", "Largest telemetry file that is accepted.", float),
    Setting("telemetry_rows", "50000000", "rows", "Most detections of a telemetry file, compressed or not.", int),
    Setting("telemetry_columns", "1000", "columns", "Most columns of a telemetry file.", int),
    Setting("session_hours", "12", "h", "A log-in ends after so long.", float),
    Setting(
        "session_idle_minutes", "60", "min", "A log-in that is not used for so long ends too; 0 = it does not.", float
    ),
    Setting(
        "login_attempts",
        "5",
        "",
        "Wrong passwords for a name from one place; after so many each further try waits.",
        int,
    ),
    Setting("webhooks_local", "0", "0 or 1", "1 = webhooks may go to this machine and its link.", int),
    Setting("webhooks_private", "0", "0 or 1", "1 = webhooks may go to private networks (RFC 1918, fc00::/7).", int),
    Setting(
        "webhook_hosts", "", "hosts", "The only hosts webhooks may go to, exact or *.suffix; empty = any.", read_hosts
    ),
    Setting(
        "webhook_key", "", "path", "File of the key that encrypts webhooks' secrets; empty = in the data folder.", str
    ),
    Setting("four_eyes", "1", "0 or 1", "0 = one person works alone here and may sign what they submitted.", int),
    Setting("second_person", "0", "0 or 1", "1 = somebody else must confirm new gate limits and table layouts.", int),
    Setting("approvals", "1", "people", "Approvals that a request needs; two at least where a gate is waived.", int),
    Setting("approval_days", "30", "d", "A request that nobody decided on expires after so long.", float),
    Setting("rollback_days", "3", "d", "The same for a request to go back to a former baseline.", float),
    Setting(
        "audit_head_file", "", "path", "Gets each new head of the audit log, a line each; outside the data folder.", str
    ),
    Setting("audit_head_minutes", "5", "min", "How often the head is written there, and told to webhooks.", float),
    Setting("secure_cookies", "0", "0 or 1", "1 = the session cookie is sent over HTTPS only.", int),
)


@dataclass(frozen=True)
class Settings:
    """The settings as values; field names are those of the table."""

    data_folder: Path
    database_url: str
    blobs: str
    blob_cache_mb: float
    host: str
    port: int
    trusted_proxies: str
    public_url: str
    mode: str
    scheduler: str
    tls_authority: str
    tls_certificate: str
    cluster_network_closed: int
    workers: int
    threads: int
    lease_s: float
    max_attempts: int
    upload_limit_mb: float
    telemetry_rows: int
    telemetry_columns: int
    session_hours: float
    session_idle_minutes: float
    login_attempts: int
    webhooks_local: int
    webhooks_private: int
    webhook_hosts: tuple[str, ...]
    webhook_key: str
    four_eyes: int
    second_person: int
    approvals: int
    approval_days: float
    rollback_days: float
    audit_head_file: str
    audit_head_minutes: float
    secure_cookies: int

    @property
    def policy(self) -> Policy:
        """What this installation asks of a request for approval."""
        return Policy(
            four_eyes=bool(self.four_eyes),
            second_person=bool(self.second_person),
            approval_days=self.approval_days,
            rollback_days=self.rollback_days,
            approvals=self.approvals,
        )

    @property
    def session_limits(self) -> SessionLimits:
        """How long log-ins last."""
        return SessionLimits(self.session_hours * 3600, self.session_idle_minutes * 60)

    @property
    def telemetry_limits(self) -> Limits:
        """How much a telemetry file may hold."""
        return Limits(rows=self.telemetry_rows, columns=self.telemetry_columns)

    @property
    def computing_threads(self) -> int:
        """Threads of a command that has the machine to itself."""
        if self.threads > 0:
            return self.threads
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

    @property
    def targets(self) -> WebhookTargets:
        """Where webhooks' messages may go."""
        return WebhookTargets(
            local=bool(self.webhooks_local),
            private=bool(self.webhooks_private),
            hosts=self.webhook_hosts,
            listening=self.host,
        )

    @property
    def secret_box(self) -> SecretBox:
        """What encrypts the secrets that the database keeps for later use."""
        return SecretBox(Path(self.webhook_key or self.data_folder / "webhooks.key").expanduser())

    @property
    def kept_head_file(self) -> Path | None:
        """Where the head of the audit log is kept; None where it is not."""
        if not self.audit_head_file:
            return None
        file = Path(self.audit_head_file).expanduser()
        refuse_place(file, self.data_folder)
        return file

    @property
    def catalogue_folder(self) -> Path:
        """Where the trimmed star catalogue is cached."""
        return self.data_folder / "catalogue"

    @property
    def blob_place(self) -> BlobLocation:
        """Where content-addressed files are kept.

        Raises
        ------
        RefusedInputError
            When the setting names no place for files.
        """
        address = parse_address(self.blobs or str(self.data_folder / "blobs"))
        return BlobLocation(address, self.data_folder / "blob-cache", int(self.blob_cache_mb * 1e6))

    @property
    def kernel_folder(self) -> Path:
        """Where Numba keeps compiled kernels."""
        return self.data_folder / "kernels"


def default_data_folder(environment: Mapping[str, str]) -> Path:
    """Return the user's data folder for Boresight, as the XDG rules give it."""
    share = environment.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share")
    return Path(share) / "boresight"


def read_settings(environment: Mapping[str, str] | None = None) -> Settings:
    """Read every setting of the table from the environment.

    Raises
    ------
    RefusedInputError
        When a value cannot be read; names the variable.
    """
    environment = os.environ if environment is None else environment
    values: dict[str, object] = {}
    for setting in SETTINGS:
        text = environment.get(setting.variable, setting.default)
        try:
            values[setting.name] = setting.read(text)
        except ValueError as error:
            raise RefusedInputError(f"{setting.variable}={text!r} cannot be read: {setting.sentence}") from error
    folder = Path(str(values["data_folder"])) if values["data_folder"] else default_data_folder(environment)
    values["data_folder"] = folder.expanduser().resolve()
    values["database_url"] = values["database_url"] or f"sqlite:///{values['data_folder']}/boresight.sqlite3"
    return Settings(**{field.name: values[field.name] for field in fields(Settings)})  # type: ignore[arg-type]


def use_kernel_folder(settings: Settings) -> None:
    """Point Numba's cache to kernels that `make` compiled for this environment, else into the data folder.

    Call it before `boresight.kernels` is first imported; a folder that is set already counts most.
    """
    compiled = Path(sys.prefix) / "kernels"
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    if compiled.is_dir() and os.access(compiled, os.W_OK):
        os.environ["NUMBA_CACHE_DIR"] = str(compiled)
        return
    try:
        settings.data_folder.mkdir(mode=0o700, parents=True, exist_ok=True)  # it will hold password hashes
        settings.kernel_folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return  # a read-only home: Numba falls back to its own cache folder
    os.environ["NUMBA_CACHE_DIR"] = str(settings.kernel_folder)


@contextmanager
def private_files(settings: Settings) -> Iterator[None]:
    """Keep what a service writes, and the folders it writes to, from every other user of the machine."""
    before = os.umask(OTHERS)
    try:
        _shut(settings.data_folder)
        if settings.blob_place.is_folder:
            _shut(Path(settings.blob_place.address))
        yield
    finally:
        os.umask(before)


def _shut(folder: Path) -> None:
    """Take the rights of others from a folder that is there; say so where it is not ours to shut."""
    if not folder.is_dir() or not folder.stat().st_mode & OTHERS:
        return
    try:
        folder.chmod(folder.stat().st_mode & ~OTHERS)
    except OSError:
        log.warning("Other users can enter %s, which holds secrets: let its owner run chmod 700 on it.", folder)
