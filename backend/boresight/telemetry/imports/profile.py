"""A mapping profile: where each quantity of telemetry stands in another program's file, and in which unit and convention.

A profile is a tree of frozen dataclasses; its JSON has the members of these classes, and `compute_json_schema` is its published
schema. What a profile leaves out is absent from the imported telemetry. A profile never changes: an altered one is the next
version, and `Profile.sha256` is the hash of all it says but its version, so that two versions which say the same have one hash.

Columns are named as the file names them. A name that is not found as it stands is looked for without regard to case, and then as
the last part of a qualified name: `STAR_X` finds `/acme/tracker/STAR_X` and `TRACKER HEALTH STAR_X`, where only one ends so. In a
wide table `{n}` stands for the number of the star. Tables without a header have columns named 1, 2, 3, ...
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

import orjson

from boresight.errors import RefusedInputError
from boresight.telemetry.read.formats import read_json

if TYPE_CHECKING:
    from pydantic import TypeAdapter

SCHEMA: Final = "boresight.import-profile/1"
Format = Literal["auto", "csv", "jsonl", "parquet", "text", "ragged", "ecsv", "sextractor", "fits", "votable", "json"]
Separator = Literal[",", ";", "tab", "space", "|"]
DecimalMark = Literal[".", ","]
Numbering = Literal["column", "name", "record", "time", "file"]
TimeSystem = Literal["utc", "tai", "gps", "j2000", "on_board"]
TimeForm = Literal["iso", "days", "seconds", "milliseconds", "microseconds", "nanoseconds", "jd", "mjd"]
Length = Literal["px", "m", "mm", "um"]
Angle = Literal["deg", "rad", "hour"]
Quantity = Literal["time", "star_id", "directions", "quaternion", "velocity", "magnitude", "sigma", "temperature"]
#: What a profile's name may be: a file, a part of an address, and a word of a command line.
NAME = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")
MOST_VERSION = 1_000_000
LONGEST_TEXT = 2_000
MOST_FAULTS_TOLD = 10
#: The largest whole number, and the longest time that is added, seconds.
MOST_WHOLE, LONGEST_OFFSET_S = 1_000_000_000, 1e9


class _Part:
    """What every class here has: a member that is not known is refused, and so is a number that JSON cannot hold."""

    __pydantic_config__: ClassVar = {"extra": "forbid", "allow_inf_nan": False}


@dataclass(frozen=True, kw_only=True)
class Layout(_Part):
    """How the file is laid out.

    Parameters
    ----------
    format
        `auto` tells it by the file; `text` is a table with another separator or without a header, `ragged` has lines of any
        length, `cells_per_star` cells per star.
    separator, header, comment
        Of text tables; lines that begin with `comment` are skipped.
    decimal
        Decimal mark of a text table's numbers. With `auto`, semicolons or tabs in the header and decimal commas are recognised.
    extension
        Name or number of the table in a FITS file or VOTable; the first one with rows if omitted.
    cells_per_star
        Of `ragged`: so many cells are one star, and a line is one exposure.
    explode
        Of `json`: members of an object that are lists, one entry per star; `stars` with objects or lists inside gives columns
        `stars.x` or `stars.1`.
    indexed
        Of `json`: lists whose entries belong to the stars that another list names by number from 0.
    where
        Rows are taken only where these columns hold one of these texts.
    """

    format: Format = "auto"
    separator: Separator = ","
    header: bool = True
    comment: str = ""
    decimal: DecimalMark = "."
    extension: str | int | None = None
    cells_per_star: int | None = None
    explode: tuple[str, ...] = ()
    indexed: dict[str, str] = field(default_factory=dict)
    where: dict[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Wide(_Part):
    """One row a frame: stars stand beside one another, `{n}` in their columns' names from `first`, at most `count` of them.

    A place is empty where its coordinates are empty or both equal `absent`, or beyond the number in `count_column`.
    """

    count: int
    first: int = 1
    absent: float | None = None
    count_column: str | None = None


@dataclass(frozen=True, kw_only=True)
class Frames(_Part):
    """How frames and exposures are numbered.

    By a column of numbers; by `name`, where every new text in the column is a new frame, as the name of an image; by `record`, a
    row of a wide table, an object of JSON or a line of a ragged file; by `time`, where every new time is a new frame; or by
    `file`, where a file is one frame. Exposures are numbered 0 without a column.
    """

    by: Numbering = "column"
    column: str | None = None
    exposure: str | None = None


@dataclass(frozen=True, kw_only=True)
class Axis(_Part):
    """One coordinate of a centroid: `origin` is what the centre of the first pixel is called, in `unit`.

    0 counts from a pixel's centre, 0.5 from a corner, 1 as FITS does; `centre` means that the middle of the detector is 0.
    `reversed` coordinates grow against the rows or columns, as from the lower left corner of an image; then `origin` is what
    the centre of the last pixel is called.
    """

    column: str
    unit: Length = "px"
    origin: float | Literal["centre"] = 0.0
    reversed: bool = False


@dataclass(frozen=True, kw_only=True)
class Detector(_Part):
    """What lengths and the middle are counted by; a sensor that is given at the import comes first."""

    rows: int | None = None
    columns: int | None = None
    pixel_pitch_m: float | None = None


@dataclass(frozen=True, kw_only=True)
class Time(_Part):
    """When a star was seen.

    Parameters
    ----------
    column, constant, keyword
        Where it stands, or the one time of the whole file (ISO 8601), or the keyword of a FITS file's first header, as DATE-OBS.
    system
        `utc`, where numbers count from 1970 without leap seconds (Unix); `tai` from 1958; `gps` from 1980-01-06; `j2000` is TT
        from 2000-01-01T12:00; `on_board` counts from `epoch`, a time in UTC, on a clock without leap seconds.
    form
        ISO 8601, Julian dates, or a number in this unit; `days` count as the other numbers do.
    week_column
        Of GPS: the week that the seconds are of.
    seconds_per_count
        Of an on-board counter: how long one count is.
    offset_s
        Added to the time, as of the middle of an exposure after its stamp.
    """

    column: str | None = None
    constant: str | None = None
    keyword: str | None = None
    system: TimeSystem = "utc"
    form: TimeForm = "iso"
    week_column: str | None = None
    epoch: str | None = None
    seconds_per_count: float = 1.0
    offset_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class StarId(_Part):
    """Hipparcos numbers; `HIP 677` is 677, and what is in `unmatched`, empty or no number is no star."""

    column: str
    unmatched: tuple[str, ...] = ("0", "-1")


@dataclass(frozen=True, kw_only=True)
class Directions(_Part):
    """Where the stars are: apparent directions, or places of a catalogue (ICRS), which become apparent where a time is known."""

    ra: str
    dec: str
    ra_unit: Angle = "deg"
    dec_unit: Literal["deg", "rad"] = "deg"
    kind: Literal["apparent", "catalogue"] = "apparent"


@dataclass(frozen=True, kw_only=True)
class Quaternion(_Part):
    """The attitude.

    Parameters
    ----------
    columns
        Four columns in the order of `order`; empty where an attitude comes from a file of its own and only `mounting` is said.
    sense
        What the rotation leads from and to.
    convention
        `hamilton` turns vectors, `jpl` turns axes: the conjugate, and what CCSDS writes.
    mounting
        (x, y, z, w), Hamilton: from the frame of the columns, as a spacecraft's body, to the detector.
    longest_gap_s
        Rows with a quaternion and no centroid are packets of their own: an exposure between two of them that are not further
        apart has the attitude interpolated.
    """

    columns: tuple[str, ...] = ()
    order: Literal["xyzw", "wxyz"] = "xyzw"
    sense: Literal["icrs_to_detector", "detector_to_icrs"] = "icrs_to_detector"
    convention: Literal["hamilton", "jpl"] = "hamilton"
    mounting: tuple[float, float, float, float] | None = None
    longest_gap_s: float = 10.0


@dataclass(frozen=True, kw_only=True)
class Velocity(_Part):
    """The satellite's velocity, GCRS: columns of x, y and z."""

    columns: tuple[str, str, str]
    unit: Literal["km/s", "m/s"] = "km/s"


@dataclass(frozen=True, kw_only=True)
class Magnitude(_Part):
    """A magnitude or, with `kind` flux, -2.5 log10 of it plus the zero point."""

    column: str
    kind: Literal["magnitude", "flux"] = "magnitude"
    zero_point: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Sigma(_Part):
    """The noise of a centroid, of one column or of both axes (then the root of the mean square), or their variances."""

    columns: tuple[str, ...]
    kind: Literal["sigma", "variance"] = "sigma"
    unit: Length = "px"


@dataclass(frozen=True, kw_only=True)
class Temperature(_Part):
    """The sensor's temperature."""

    column: str
    unit: Literal["degC", "K"] = "degC"


@dataclass(frozen=True, kw_only=True)
class Profile(_Part):
    """A mapping profile.

    `optional`: quantities that are left out, with a note, where the file lacks their columns. `keep`: columns that go along
    under their own names, or `all`.
    """

    schema: Literal["boresight.import-profile/1"] = SCHEMA
    name: str
    version: int = 1
    description: str = ""
    layout: Layout = field(default_factory=Layout)
    wide: Wide | None = None
    frames: Frames = field(default_factory=Frames)
    row: Axis | None = None
    col: Axis | None = None
    detector: Detector = field(default_factory=Detector)
    time: Time | None = None
    star_id: StarId | None = None
    directions: Directions | None = None
    quaternion: Quaternion | None = None
    velocity: Velocity | None = None
    magnitude: Magnitude | None = None
    sigma: Sigma | None = None
    temperature: Temperature | None = None
    optional: tuple[Quantity, ...] = ()
    keep: tuple[str, ...] | Literal["all"] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return its JSON, without what says nothing."""
        document: dict[str, Any] = orjson.loads(orjson.dumps(_list_stated(self)))
        return document

    @property
    def sha256(self) -> str:
        """Hash of all it says but its version."""
        return hashlib.sha256(
            orjson.dumps(_list_stated(replace(self, version=1)), option=orjson.OPT_SORT_KEYS)
        ).hexdigest()


def _list_stated(part: Any) -> dict[str, Any]:
    """Return the members that are not what they are by default, and those that have no default."""
    told = {"schema": part.schema, "name": part.name, "version": part.version} if isinstance(part, Profile) else {}
    for item in fields(part):
        value = getattr(part, item.name)
        is_default = value == item.default or (callable(item.default_factory) and value == item.default_factory())
        if not is_default:
            told[item.name] = _list_stated(value) if is_dataclass(value) else value
    return told


@cache
def _adapter() -> TypeAdapter[Profile]:
    from pydantic import TypeAdapter  # noqa: PLC0415 - only where a profile is read

    return TypeAdapter(Profile)


def compute_json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a profile."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": SCHEMA,
        **_adapter().json_schema(mode="validation"),
    }


def parse_profile(document: Mapping[str, Any], name: str = "The profile") -> Profile:
    """Read a profile's JSON; refuses what it says twice, not at all or in part."""
    from pydantic import ValidationError  # noqa: PLC0415 - only where a profile is read

    try:
        profile = _adapter().validate_python(_listed(document))
    except ValidationError as error:
        faults = error.errors(include_url=False)
        told = "; ".join(
            f"{'.'.join(str(part) for part in fault['loc']) or 'it'}: "
            + str(fault["msg"]).replace("Unexpected keyword argument", "there is no such member")
            for fault in faults[:MOST_FAULTS_TOLD]
        )
        more = f"; and {len(faults) - MOST_FAULTS_TOLD:,} more" if len(faults) > MOST_FAULTS_TOLD else ""
        raise RefusedInputError(
            f"{name} cannot be used: {told}{more}: correct it by `boresight schema import-profile`."
        ) from error
    _check(profile, name)
    return profile


def _listed(value: Any) -> Any:
    """Return a document with its lists as tuples, as the classes have them."""
    if isinstance(value, Mapping):
        return {str(key): _listed(item) for key, item in value.items()}
    return tuple(_listed(item) for item in value) if isinstance(value, list) else value


def read_profile(path: Path) -> Profile:
    """Read a profile's file."""
    try:
        document = read_json(path, path.name)
    except ValueError as error:
        if isinstance(error, RefusedInputError):
            raise
        raise RefusedInputError(f"{path.name} is not JSON ({error}): give a mapping profile.") from error
    if not isinstance(document, Mapping):
        raise RefusedInputError(f"{path.name} contains no JSON object: give a mapping profile.")
    return parse_profile(document, path.name)


def _check(profile: Profile, name: str) -> None:
    """Refuse what cannot be meant."""
    remedies = [remedy for wrong, remedy in _troubles(profile) if wrong]
    if remedies:
        raise RefusedInputError(f"{name} cannot be used: {'; '.join(remedies)}: correct it.")


def _troubles(profile: Profile) -> list[tuple[bool, str]]:
    """Return what may be wrong with a profile, and what to do."""
    layout, time, wide, turned = profile.layout, profile.time, profile.wide, profile.quaternion
    columns, detector = () if turned is None else turned.columns, profile.detector
    texts = _texts(_list_stated(profile))
    return [
        (not NAME.fullmatch(profile.name), "its name must be of lower-case letters, digits, dots and dashes, at most 64 in all"),
        (any(abs(number) > MOST_WHOLE for number in _wholes(_list_stated(profile))), f"a number is over {MOST_WHOLE:,}"),
        (not 1 <= profile.version <= MOST_VERSION, "its version must be a number from 1"),
        (any(len(text) > LONGEST_TEXT or "\0" in text for text in texts), f"a text is over {LONGEST_TEXT:,} characters"),
        (len(texts) > LONGEST_TEXT, f"it has over {LONGEST_TEXT:,} texts"),
        ((profile.row is None) != (profile.col is None), "give both row and col, or neither"),
        (profile.row is None and not columns, "give row and col, or quaternion.columns of a file of attitudes"),
        (
            (profile.frames.by in {"column", "name"}) != (profile.frames.column is not None),
            "frames.column goes with frames.by column or name",
        ),
        (profile.frames.by == "time" and time is None, "frames are numbered by time, and none is given: give time"),
        (
            time is not None and [time.column, time.constant, time.keyword].count(None) != 2,
            "give one of time.column, time.constant and time.keyword",
        ),
        (
            time is not None
            and time.system == "on_board"
            and (not (time.epoch or "").strip() or time.form in {"iso", "jd", "mjd"}),
            "an on-board counter needs time.epoch, the UTC at which it was 0, and a form that is a number",
        ),
        (time is not None and time.week_column is not None and time.system != "gps", "time.week_column goes with gps"),
        (time is not None and abs(time.offset_s) > LONGEST_OFFSET_S, f"time.offset_s is over {LONGEST_OFFSET_S:,.0f} seconds"),
        (any(size is not None and size < 1 for size in (detector.rows, detector.columns)), "detector.rows and columns are from 1"),
        (
            detector.pixel_pitch_m is not None and not 1e-8 <= detector.pixel_pitch_m <= 1e-2,
            "detector.pixel_pitch_m is 1e-8 to 0.01",
        ),
        (len(columns) not in {0, 4}, "quaternion.columns are four"),
        (profile.sigma is not None and len(profile.sigma.columns) not in {1, 2}, "sigma.columns are one or two"),
        (wide is not None and not (1 <= wide.count <= 10_000 and 0 <= wide.first <= 10_000), "wide.count is 1 to 10000"),
        (layout.decimal == "," == layout.separator, "a comma cannot separate columns and be decimal: give layout.separator"),
        ((layout.format == "ragged") != (layout.cells_per_star is not None), "layout.cells_per_star goes with ragged"),
        (layout.cells_per_star is not None and not 1 <= layout.cells_per_star <= 100, "layout.cells_per_star is 1 to 100"),
    ]  # fmt: skip


def _wholes(value: Any) -> list[int]:
    """Return every whole number of a document."""
    if isinstance(value, Mapping):
        return [number for item in value.values() for number in _wholes(item)]
    return [value] if isinstance(value, int) else []


def _texts(value: Any) -> list[str]:
    """Return every text of a document."""
    if isinstance(value, Mapping):
        return [text for key, item in value.items() for text in (key, *_texts(item))]
    if isinstance(value, tuple):
        return [text for item in value for text in _texts(item)]
    return [value] if isinstance(value, str) else []
