"""Every setting in one table: name, default, unit, sentence. Read once at a door and passed down as a value."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from boresight.errors import RefusedInputError
from boresight.images.limits import ImageLimits
from boresight.platform.actors import Policy, SessionLimits
from boresight.platform.audit.external_head import refuse_within_data_folder
from boresight.platform.blobs.locations import BlobLocation, parse_address
from boresight.platform.observability.logs import FORMATS
from boresight.platform.web.targets import WebhookTargets, read_hosts
from boresight.telemetry.read.limits import Limits

if TYPE_CHECKING:
    from boresight.mission_control.systems import Link
    from boresight.platform.audit.signing import SigningKey
    from boresight.platform.audit.time_stamps import TimeStampService
    from boresight.platform.backups.encryption import KeyFile
    from boresight.platform.db.secret_box import SecretBox

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


def _bucket(text: str) -> str:
    """Read the address of a place in an object store: empty, or a URL without credentials."""
    if text and "://" not in text:
        raise ValueError(text)
    return parse_address(text, "BORESIGHT_WATCH_BUCKET") if text else text


def _words(text: str) -> tuple[str, ...]:
    """Read words separated by commas or spaces."""
    return tuple(dict.fromkeys(text.lower().replace(",", " ").split()))


def _mail_server(text: str) -> str:
    """Read the address of a mail server: empty, or mailto:// or mailtos:// with a host."""
    parts = urlsplit(text)
    if text and (parts.scheme not in {"mailto", "mailtos"} or not parts.hostname or "to=" in parts.query):
        raise ValueError(text)
    return text


def _make_word_reader(*words: str) -> Callable[[str], str]:
    """Return what reads one of these words."""

    def read(text: str) -> str:
        if text not in words:
            raise ValueError(text)
        return text

    return read


def _read_roles(text: str) -> tuple[tuple[str, str], ...]:
    """Read pairs `group=role` that are separated by semicolons; a group's name may contain = and commas."""
    pairs = [pair.rpartition("=") for pair in text.split(";") if pair.strip()]
    if any(not group.strip() or not role.strip() for group, _, role in pairs):
        raise ValueError(text)
    return tuple((group.strip(), role.strip()) for group, _, role in pairs)


def _setting(
    default: str,
    unit: str,
    sentence: str,
    read: Callable[[str], object] | None = None,
    *,
    shown: bool = True,
) -> Any:
    """Declare a row of the table: a field of the settings, read by its own type where nothing else is said."""
    return field(repr=shown, metadata={"default": default, "unit": unit, "sentence": sentence, "read": read})


@dataclass(frozen=True)
class WeakSetting:
    """A setting that weakens what protects an installation, its value, and what follows."""

    variable: str
    value: str
    why: str


@dataclass(frozen=True)
class Settings:
    """Every setting, each declared once; its value is what its row reads."""

    data_folder: Path = _setting(  # noqa: RUF009 - a field of a dataclass, no value
        "", "path", "Database, blobs, catalogue, compiled kernels; empty = your data folder."
    )
    database_url: str = _setting("", "URL", "SQLAlchemy address of the store; empty = SQLite in the data folder.")
    blobs: str = _setting("", "path or URL", "Folder of files, or s3://bucket/prefix; empty = in the data folder.")
    blob_cache_mb: float = _setting(
        "10240", "MB", "Size of the local cache for an object store; the least recently used files are removed."
    )
    host: str = _setting("127.0.0.1", "address", "Address the server listens on.")
    port: int = _setting("8000", "", "Port the server listens on.")
    trusted_proxies: str = _setting("127.0.0.1", "addresses", "Proxies whose X-Forwarded-For and -Proto are trusted.")
    public_url: str = _setting(
        "", "URL", "Public address of the server behind a proxy; empty = that of the Host header.", read=_site
    )
    drain_s: float = _setting(
        "0",
        "s",
        "After a stop request, the server keeps running for this time while /readyz returns 503, so that a proxy can switch to "
        "another server.",
    )
    mode: str = _setting("OPS", "", "Tag in the top bar: OPS, SIM or TRAINING.")
    scheduler: str = _setting(
        "", "address", "Dask scheduler, tls://host:port; empty = the server's own worker processes."
    )
    tls_authority: str = _setting(
        "", "path", "Authority (PEM) that signed every machine's certificate, for tls:// links."
    )
    tls_certificate: str = _setting("", "path", "This machine's certificate and key in one PEM file, for tls:// links.")
    cluster_network_closed: int = _setting(
        "0", "0 or 1", "1 = plain tcp:// links to other machines are allowed: nobody else is on their network."
    )
    workers: int = _setting("2", "processes", "Worker processes started when no scheduler is given; 0 = none here.")
    threads: int = _setting(
        "0", "threads", "Threads that a command computes on, 0 = one per core; worker processes use one each."
    )
    lease_s: float = _setting("10", "s", "Time after which a run's lease lapses unless it is renewed.")
    max_attempts: int = _setting("3", "", "Number of lost attempts after which a run is set to FAILED.")
    upload_limit_mb: float = _setting("512", "MB", "Largest telemetry file that is accepted.")
    telemetry_rows: int = _setting(
        "50000000", "rows", "Maximum number of detections in a telemetry file, compressed or not."
    )
    telemetry_columns: int = _setting("1000", "columns", "Maximum number of columns in a telemetry file.")
    images: int = _setting("2000", "images", "Maximum number of images in one set.")
    image_mb: float = _setting(
        "512", "MB", "Largest image file; BORESIGHT_UPLOAD_LIMIT_MB applies to all images of an upload together."
    )
    image_seconds: float = _setting("600", "s", "Maximum time that a server works on the images of one upload.")
    image_megapixels: float = _setting("150", "megapixels", "Largest image, checked before it is expanded.")
    session_hours: float = _setting("12", "h", "A log-in ends after this time.")
    session_idle_minutes: float = _setting("60", "min", "A log-in that is unused for this time ends; 0 = never.")
    login_attempts: int = _setting(
        "5", "", "Number of wrong passwords per name and address before further attempts are delayed."
    )
    second_factor: str = _setting(
        "optional",
        "",
        "off, optional, or required-to-sign (approvers and administrators must enrol one before they can do anything else).",
        read=_make_word_reader("off", "optional", "required-to-sign"),
    )
    security_log: str = _setting(
        "",
        "path or -",
        "File that gets each security event as a line of JSON, for a SIEM; - = standard output; empty = none.",
    )
    oidc_issuer: str = _setting(
        "", "URL", "OpenID Connect provider for single sign-on; empty = none. Needs BORESIGHT_PUBLIC_URL.", read=_site
    )
    oidc_client_id: str = _setting("", "", "Client id of this server at the provider.")
    oidc_client_secret: str = _setting("", "", "Client secret at the provider; better in a file.", shown=False)
    oidc_client_secret_file: str = _setting("", "path", "File with the client secret.")
    oidc_label: str = _setting("Log in with single sign-on", "", "Label of the button on the log-in page.")
    oidc_scopes: str = _setting("openid profile", "", "Scopes that the provider is asked for.")
    oidc_name_claim: str = _setting("preferred_username", "", "Claim of the ID token that gives the log-in name.")
    oidc_groups_claim: str = _setting("groups", "", "Claim of the ID token that lists the groups of a person.")
    oidc_roles: tuple[tuple[str, str], ...] = _setting(
        "", "group=role; ...", "Which group at the provider gives which role.", read=_read_roles
    )
    webhooks_local: int = _setting(
        "0", "0 or 1", "1 = webhooks and messages may go to this machine and link-local addresses."
    )
    webhooks_private: int = _setting(
        "0", "0 or 1", "1 = webhooks and messages may go to private networks (RFC 1918, fc00::/7)."
    )
    webhook_hosts: tuple[str, ...] = _setting(
        "", "hosts", "The only hosts webhooks and messages may go to, exact or *.suffix; empty = any.", read=read_hosts
    )
    webhook_key: str = _setting(
        "",
        "path",
        "File with the key that encrypts webhooks' secrets and people's addresses; empty = in the data folder.",
    )
    message_services: tuple[str, ...] = _setting(
        "mailto slack workflows discord gchat ntfys mmosts rockets matrixs tgram wxteams pagerduty opsgenie",
        "schemes",
        "Services by which people may have messages sent to them, by apprise's scheme; empty = none.",
        read=_words,
    )
    mail_server: str = _setting(
        "",
        "URL",
        "Mail server of these messages, mailtos://user:password@host:port?from=address; empty = no mail.",
        read=_mail_server,
    )
    watch_folder: str = _setting(
        "", "path", "Folder watched for new telemetry, with a subfolder per sensor, named after it; empty = none."
    )
    watch_settle_s: float = _setting("10", "s", "A file is ingested once it has been unchanged for this time.")
    watch_bucket: str = _setting(
        "",
        "URL",
        "Bucket watched for new telemetry, s3://bucket/prefix, with a folder per sensor, named after it; empty = none.",
        read=_bucket,
    )
    watch_bucket_s: float = _setting("30", "s", "How often the watched bucket is listed.")
    yamcs_url: str = _setting("", "URL", "Yamcs server that telemetry is pulled from; empty = none.", read=_site)
    yamcs_instance: str = _setting("", "", "Instance of that Yamcs server.")
    yamcs_credentials: str = _setting(
        "", "path", "File whose first line is name:password, or an API key, for Yamcs; empty = none is needed."
    )
    yamcs_authority: str = _setting(
        "", "path", "Authority (PEM) that signed the certificate of Yamcs; empty = public ones."
    )
    yamcs_bucket: str = _setting("", "", "Yamcs bucket to which tables are handed over; empty = none.")
    yamcs_events: int = _setting(
        "0", "0 or 1", "1 = waiting requests, promotions and alarms are sent to Yamcs as events."
    )
    openc3_url: str = _setting(
        "", "URL", "OpenC3 COSMOS server that telemetry is pulled from; empty = none.", read=_site
    )
    openc3_scope: str = _setting("DEFAULT", "", "Scope of that OpenC3 server.")
    openc3_credentials: str = _setting(
        "", "path", "File whose first line is the password of OpenC3; empty = none is needed."
    )
    openc3_authority: str = _setting(
        "", "path", "Authority (PEM) that signed the certificate of OpenC3; empty = public ones."
    )
    openc3_target: str = _setting("", "", "OpenC3 target whose tables are handed over; empty = none.")
    four_eyes: int = _setting("1", "0 or 1", "0 = four-eyes rule off: one person can submit and sign alone.")
    second_person: int = _setting(
        "1",
        "0 or 1",
        "1 = a second person must confirm new gate limits and table definitions, unless the four-eyes rule is off.",
    )
    approvals: int = _setting("1", "people", "Number of approvals a request needs; at least two if a gate is waived.")
    rest_review: int = _setting(
        "0",
        "0 or 1",
        "1 = approvals over REST must also answer every point of the request, and promotions must give a reason.",
    )
    approval_days: float = _setting("30", "d", "Time after which an undecided request expires.")
    rollback_days: float = _setting("3", "d", "Time after which an undecided roll-back request expires.")
    promotion_password: int = _setting("1", "0 or 1", "1 = promoting a set on a page needs the password again.")
    promotion_reason: int = _setting(
        "0", "0 or 1", "1 = promotions over REST also need a reason (always required on the page)."
    )
    audit_head_file: str = _setting(
        "", "path", "File that gets each new head of the audit log, one per line; outside the data folder."
    )
    audit_head_minutes: float = _setting("5", "min", "How often the head is written there, and sent to webhooks.")
    anchor_minutes: float = _setting(
        "60", "min", "Interval at which the audit log head is signed if it has changed; 0 = only on request."
    )
    signing_key: str = _setting(
        "", "path or PEM", "Ed25519 key that signs heads and uplink packages; empty = a file in the data folder."
    )
    timestamp_url: str = _setting(
        "", "URL", "Time-stamp service (RFC 3161) for signed heads; empty = none.", read=_site
    )
    timestamp_certificates: str = _setting(
        "", "path", "Certificates (PEM) of the authorities that its time-stamps must lead back to."
    )
    log_format: str = _setting(
        "text",
        "text or json",
        "json = one JSON object per line, with request, person, run and trace.",
        read=_make_word_reader(*FORMATS),
    )
    otlp_endpoint: str = _setting(
        "", "URL", "Collector of traces by OTLP over HTTP, without /v1/traces; empty = no traces.", read=_site
    )
    telemetry_keep_days: float = _setting(
        "0", "d", "Telemetry files that are no longer needed are removed after this time; 0 = kept forever."
    )
    backup_key: str = _setting(
        "",
        "path",
        "File with the keys that encrypt scheduled backups; empty = in the data folder. Keep a copy elsewhere.",
    )
    secure_cookies: int = _setting("0", "0 or 1", "1 = the session cookie is sent over HTTPS only.")

    def list_weaknesses(self) -> list[WeakSetting]:
        """Return the settings that weaken what protects an installation, for the security log."""
        reached = self.host not in {"127.0.0.1", "::1", "localhost"} or bool(self.public_url)
        found = {
            "four_eyes": (not self.four_eyes, "one person can submit and sign alone"),
            "second_person": (not self.second_person, "one person changes gate limits and table definitions alone"),
            "second_factor": (self.second_factor == "off", "a password alone logs in and signs"),
            "promotion_password": (not self.promotion_password, "a log-in that was left open can promote"),
            "secure_cookies": (reached and not self.secure_cookies, "the cookie is sent over plain HTTP too"),
            "session_idle_minutes": (self.session_idle_minutes == 0, "a log-in that is left open does not end"),
            "webhooks_local": (bool(self.webhooks_local), "webhooks reach this machine"),
            "webhooks_private": (bool(self.webhooks_private), "webhooks reach private networks"),
            "cluster_network_closed": (bool(self.cluster_network_closed), "links to workers may be plain"),
        }
        return [
            WeakSetting(f"BORESIGHT_{name.upper()}", str(getattr(self, name)), why)
            for name, (is_weak, why) in found.items()
            if is_weak
        ]

    @property
    def policy(self) -> Policy:
        """What this installation asks of a request for approval."""
        return Policy(
            four_eyes=bool(self.four_eyes),
            second_person=bool(self.second_person and self.four_eyes),
            approval_days=self.approval_days,
            rollback_days=self.rollback_days,
            approvals=self.approvals,
            rest_review=bool(self.rest_review),
            promotion_password=bool(self.promotion_password),
            promotion_reason=bool(self.promotion_reason),
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
    def image_limits(self) -> ImageLimits:
        """How much images may hold."""
        return ImageLimits(self.images, int(self.image_mb * 1e6), int(self.image_megapixels * 1e6))

    @property
    def computing_threads(self) -> int:
        """Threads of a command that has the machine to itself."""
        if self.threads > 0:
            return self.threads
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

    @property
    def page_root(self) -> str:
        """Where the pages of this server are for whoever gets a message."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return self.public_url.rstrip("/") or f"http://{host}:{self.port}"

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
        from boresight.platform.db.secret_box import SecretBox  # noqa: PLC0415 - cryptography is for servers

        return SecretBox(Path(self.webhook_key or self.data_folder / "webhooks.key").expanduser())

    @property
    def own_key(self) -> SigningKey:
        """What signs in this installation's name."""
        from boresight.platform.audit.signing import PEM_BEGINS, SigningKey  # noqa: PLC0415 - cryptography is for servers

        if self.signing_key.startswith(PEM_BEGINS):
            return SigningKey(self.signing_key)
        return SigningKey(Path(self.signing_key or self.data_folder / "signing.key").expanduser())

    @property
    def time_stamps(self) -> TimeStampService | None:
        """The time-stamp service; None where none is set."""
        from boresight.platform.audit.time_stamps import TimeStampService, read_certificates  # noqa: PLC0415 - as above

        if not self.timestamp_url:
            return None
        file = Path(self.timestamp_certificates).expanduser()
        try:
            return TimeStampService(self.timestamp_url, read_certificates(file.read_bytes(), file))
        except OSError as error:
            raise RefusedInputError(
                f"BORESIGHT_TIMESTAMP_CERTIFICATES={self.timestamp_certificates!r} cannot be read ({error.strerror}): name the PEM "
                "file of the time-stamp service's authorities."
            ) from error

    @property
    def backup_keys(self) -> KeyFile:
        """The keys of backups."""
        from boresight.platform.backups.encryption import KeyFile  # noqa: PLC0415 - cryptography is for servers

        return KeyFile(Path(self.backup_key or self.data_folder / "backup.key").expanduser())

    @property
    def kept_head_file(self) -> Path | None:
        """Where the head of the audit log is kept; None where it is not."""
        if not self.audit_head_file:
            return None
        file = Path(self.audit_head_file).expanduser()
        refuse_within_data_folder(file, self.data_folder)
        return file

    @property
    def watched_folder(self) -> Path | None:
        """Folder that is watched for new telemetry; None where none is."""
        return Path(self.watch_folder).expanduser().resolve() if self.watch_folder else None

    @property
    def mission_control(self) -> Mapping[str, Link]:
        """The mission control systems that this installation is linked to, by their words."""
        from boresight.mission_control.systems import Link  # noqa: PLC0415 - few commands need HTTP

        links = (
            Link(
                "yamcs",
                self.yamcs_url,
                self.yamcs_instance,
                self.yamcs_bucket,
                self.yamcs_credentials,
                self.yamcs_authority,
            ),
            Link(
                "openc3",
                self.openc3_url,
                self.openc3_scope,
                self.openc3_target,
                self.openc3_credentials,
                self.openc3_authority,
            ),
        )
        return {link.system: link for link in links if link.url}

    @property
    def catalogue_folder(self) -> Path:
        """Where the trimmed star catalogue is cached."""
        return self.data_folder / "catalogue"

    @property
    def blob_location(self) -> BlobLocation:
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


_READERS: dict[str, Callable[[str], object]] = {"int": int, "float": float}


def _row(item: Field[Any]) -> Setting:
    said = item.metadata
    return Setting(
        item.name, said["default"], said["unit"], said["sentence"], said["read"] or _READERS.get(str(item.type), str)
    )


SETTINGS = tuple(map(_row, fields(Settings)))


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
            raise RefusedInputError(
                f"{setting.variable}={text!r} is not valid: correct or remove it. {setting.sentence}"
            ) from error
    folder = Path(str(values["data_folder"])) if values["data_folder"] else default_data_folder(environment)
    values["data_folder"] = folder.expanduser().resolve()
    values["database_url"] = values["database_url"] or f"sqlite:///{values['data_folder']}/boresight.sqlite3"
    return Settings(**values)  # type: ignore[arg-type]


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
        if settings.blob_location.is_folder:
            _shut(Path(settings.blob_location.address))
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
        log.warning("Other users can enter %s, which contains secrets: let its owner run chmod 700 on it.", folder)
