"""What another program's file is, told by its first bytes and columns, and which profile reads it.

A built-in profile fits where the file has every column that it cannot do without; of several the one that finds most of its
columns. Where none fits, a first profile is drafted from the names of the columns, without regard to case, dots and dashes;
what a name does not tell, as where pixels are counted from, is listed for a person to tell.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from boresight.arrays import FloatArray
from boresight.errors import Fault, RefusedInputError
from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.imports.profile import (
    Axis,
    Directions,
    Frames,
    Layout,
    Magnitude,
    Numbering,
    Profile,
    Quaternion,
    Sigma,
    StarId,
    Temperature,
    Time,
    TimeForm,
    Wide,
)
from boresight.telemetry.imports.tables import (
    SourceTable,
    detect_form,
    find_fits_columns,
    look_at_text,
    read_head,
    read_source,
    split_row,
)
from boresight.telemetry.read.compression import expanded, name_inside
from boresight.telemetry.read.formats import BYTE_ORDER_MARK, format_at, parse_json
from boresight.telemetry.read.limits import LIMITS
from boresight.wording import join_words

#: Bytes of a JSON document that is read whole to see what it holds.
_MOST_JSON_BYTES: Final = 16_000_000
_SHOWN: Final = 6
#: Names that quantities go by, as letters and digits alone; the first that a file has counts.
_SYNONYMS: Final[Mapping[str, tuple[str, ...]]] = {
    "frame": ("frame", "frameid", "framenumber", "frameno", "image", "imageid", "img", "imagenumber", "packet", "seq"),
    "exposure": ("exposure", "exposureid", "exposurenumber"),
    "row": (
        "rowpx", "row", "ypx", "ycentroid", "ypix", "ypixel", "yimage", "centroidy", "ycen", "ypos", "posy", "stary", "cy", "yc",
        "v", "line", "y",
    ),
    "col": (
        "colpx", "col", "column", "xpx", "xcentroid", "xpix", "xpixel", "ximage", "centroidx", "xcen", "xpos", "posx", "starx",
        "cx", "xc", "u", "x",
    ),
    "time": ("timeutc", "utc", "time", "timestamp", "datetime", "dateobs", "jd", "mjd", "epoch", "t"),
    "star_id": ("starid", "hip", "hipid", "hipparcos", "hipnumber", "catalogid", "catid"),
    "ra": ("radeg", "ra", "rightascension"),
    "dec": ("decdeg", "dec", "de", "declination"),
    "magnitude": ("magnitude", "mag", "vmag", "magauto", "brightness"),
    "flux": ("flux", "fluxauto", "counts", "intensity", "signal", "sum"),
    "sigma": ("sigmapx", "sigma", "centroidsigma", "err"),
    "temperature": ("temperaturec", "temperature", "temp", "tempc"),
}  # fmt: skip
_QUATERNIONS: Final = (("qx", "qy", "qz", "qw"), ("q1", "q2", "q3", "q4"), ("qi", "qj", "qk", "qs"))
#: Names of coordinates that do not say which of them is which, so that a person has to look.
_OF_AN_IMAGE: Final = ("x", "y", "u", "v", "ximage", "yimage")
_DAY, _DAY_LENGTH = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}"), 10
#: A unit behind a name, as in `x[px]`.
_UNIT = re.compile(r"\s*[\[(][^\])]*[\])]")
_COORDINATES: Final = 2
#: Stars of one line that no table of one star a row has columns for.
_MANY_STARS: Final = 10
#: No detector has more pixels along a side, and no magnitude is larger.
_LARGEST_PX, _FAINTEST = 30_000.0, 30.0
#: Between what numbers a column that never falls is taken for a time, of today's decades: Julian dates, modified ones, Unix times.
_CLOCKS: Final[Mapping[TimeForm, tuple[float, float]]] = {
    "jd": (2.4e6, 2.5e6), "mjd": (4e4, 8e4), "seconds": (5e8, 4e9), "milliseconds": (5e11, 4e12),
}  # fmt: skip
_NUMBERED = re.compile(r"^(.*?)(\d{1,9})(?!\d)(.*)$")  # no star has a longer number


@dataclass(frozen=True)
class Recognised:
    """What a file is.

    `kind`: with its article. `columns`: names in their order. `layout`: how it is read, `auto` where that does.
    `example`: the first cell of each column that was looked at. `told`: names that a comment gives to columns which have but
    numbers, with these; `guess`: without them, columns by what their cells look like. `widths`: cells of lines without a header.
    """

    name: str
    kind: str
    columns: tuple[str, ...]
    layout: Layout = field(default_factory=Layout)
    example: Mapping[str, str] = field(default_factory=dict)
    told: Mapping[str, str] = field(default_factory=dict)
    guess: Mapping[str, str] = field(default_factory=dict)
    widths: tuple[int, ...] = ()

    @property
    def profile(self) -> Profile | None:
        """The built-in profile that fits best; None where none does."""
        return next(iter(self.rank(BUILT_IN.values())), None)

    def rank(self, profiles: Iterable[Profile]) -> list[Profile]:
        """Return the profiles that fit, the likeliest first: that finds most columns, has the file's suffix, came last."""
        found = [(score, place, one) for place, one in enumerate(profiles) if (score := self._score(one)) > 0]
        suffix = name_inside(self.name).suffix.lower().removeprefix(".") or "-"
        found.sort(key=lambda one: (one[0], one[2].name.endswith(suffix), one[1]), reverse=True)
        return [one for _, _, one in found]

    def _score(self, profile: Profile) -> int:
        """Count the columns of a profile that are there; 0 where one that it needs is not, or the layout is another."""
        layout, plain = profile.layout, Layout()
        if layout.format == "ragged":
            return self._count_ragged(layout)
        if (layout.explode or self.layout.explode) and layout.explode[:1] != self.layout.explode[:1]:
            return 0
        is_other = layout.separator not in {plain.separator, self.layout.separator}
        is_other |= layout.format == "fits" != self.layout.format
        if is_other or (profile.frames.by == "file" and "frame" in self._names):
            return 0
        if layout.explode:
            return sum(key.split(".")[0] in layout.explode for key in self.columns) + 1
        table = SourceTable(
            self.name, {column: pa.nulls(0) for column in self.columns}, np.zeros(0, np.int64), np.zeros(0, np.int64)
        )
        read = {quantity: columns for quantity, columns in _list_columns(profile) if columns}
        present = {quantity: all(map(table.has, columns)) for quantity, columns in read.items()}
        if any(not there for quantity, there in present.items() if quantity not in profile.optional):
            return 0
        return sum(present.values())

    def _count_ragged(self, layout: Layout) -> int:
        """Count the cells of a star where lines have several stars each, and not all as many."""
        cells = layout.cells_per_star or 1
        has_stars = all(width % cells == 0 and width >= _COORDINATES * cells for width in self.widths)
        differ = len(set(self.widths)) > 1 or max(self.widths, default=0) >= _MANY_STARS * cells
        return cells if has_stars and differ and self.layout.separator == layout.separator else 0

    @property
    def _names(self) -> dict[str, str]:
        """The column of each quantity, by its name or by what its cells look like."""
        return dict(self.guess) if self.guess else _find_names(self.columns)[0]

    @property
    def is_of_another_program(self) -> bool:
        """Whether an import can read it, and telemetry's own reader cannot."""
        is_plain = self.layout == Layout() and self.kind in {"a table", "JSON", "Parquet"}
        if is_plain and {"row_px", "col_px"} & set(self.columns):
            return False
        return not is_plain or self.profile is not None or {"row", "col"} <= _find_names(self.columns)[0].keys()

    @property
    def command(self) -> str:
        """The command that reads the file, or writes a first profile for it."""
        name = Path(self.name).name
        if (profile := self.profile) is not None:
            return f"boresight import {name} --profile {profile.name} --out {name_inside(name).stem}-stars.csv"
        return f"boresight import {name} --print-profile > mine.json"

    def say(self) -> str:
        """Say in a clause what the file is and what to do with it."""
        listed = ", ".join([*self.columns[:_SHOWN], *(["..."] if len(self.columns) > _SHOWN else [])])
        named = listed or "no columns" if self.layout.header else f"columns 1 to {len(self.columns)}"
        told = f"it is {self.kind} of another program, with {named}"
        if (profile := self.profile) is not None:
            return (
                f"{told}, which the built-in mapping profile {profile.name} reads: run `{self.command}`, or choose this profile "
                "(`--profile`) with the file"
            )
        return (
            f"{told}, and no built-in mapping profile fits: write a first one by `{self.command}` (on the page by Preview import), "
            f"complete it, and run `boresight import {Path(self.name).name} --profile mine.json`"
        )


def _list_columns(profile: Profile) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield each quantity that a profile reads with its columns; of a wide table those of its first star."""
    first = "" if profile.wide is None else str(profile.wide.first)

    def named(*columns: str | None) -> tuple[str, ...]:
        return tuple(column.replace("{n}", first) for column in columns if column is not None)

    yield "row", named(None if profile.row is None else profile.row.column)
    yield "col", named(None if profile.col is None else profile.col.column)
    yield "frame", named(profile.frames.column, profile.frames.exposure)
    yield "time", named(None if profile.time is None else profile.time.column)
    yield "star_id", named(None if profile.star_id is None else profile.star_id.column)
    yield "magnitude", named(None if profile.magnitude is None else profile.magnitude.column)
    yield "temperature", named(None if profile.temperature is None else profile.temperature.column)
    yield "sigma", () if profile.sigma is None else named(*profile.sigma.columns)
    yield "directions", () if profile.directions is None else named(profile.directions.ra, profile.directions.dec)
    yield "quaternion", () if profile.quaternion is None else named(*profile.quaternion.columns)
    yield "velocity", () if profile.velocity is None else named(*profile.velocity.columns)


def recognise_table(path: Path, name: str) -> Recognised | None:
    """Return what table of another program a file is; None where it is none that an import reads."""
    try:
        with expanded(path, name, LIMITS) as place:
            return _recognise(place, name)
    except (RefusedInputError, ValueError, OSError, NotImplementedError, csv.Error):  # of files that nothing can read
        return None


@contextmanager
def leading_to_import(path: Path, name: str) -> Iterator[None]:
    """Lead a refusal of another program's table to its import; what is telemetry, or nothing that is known, keeps its own."""
    try:
        yield
    except RefusedInputError as error:
        found = recognise_table(path, name)
        if found is None or not found.is_of_another_program:
            raise
        remedy, fitting = found.say(), found.profile
        faults = () if fitting is None else (Fault(None, "profile", f"send {fitting.name} with the file"),)
        raise RefusedInputError(f"{name} is not in telemetry format: {remedy}.", faults) from error


def _recognise(path: Path, name: str) -> Recognised | None:  # noqa: PLR0911 - one a form
    head = read_head(path)
    start = head.removeprefix(BYTE_ORDER_MARK).lstrip()
    if start.startswith((b"{", b"[")):
        return _recognise_json(path, name, start)
    if head.startswith(b"PAR1"):
        import pyarrow.parquet as arrow_parquet  # noqa: PLC0415 - with every file system that Arrow knows, 40 ms

        return Recognised(name, "Parquet", tuple(arrow_parquet.read_schema(path).names))
    match detect_form(path, name, Layout()):
        case "fits":
            columns = find_fits_columns(path, name)
            return Recognised(name, "a FITS table", columns, Layout(format="fits")) if columns else None
        case "votable":
            return _recognise_whole(path, name, "a VOTable")
        case "ecsv":
            return _recognise_whole(path, name, "an ECSV table")
        case "sextractor":
            return _recognise_whole(path, name, "a SExtractor catalogue")
        case _:
            return _recognise_text(name, head)


def _recognise_whole(path: Path, name: str, kind: str) -> Recognised:
    return Recognised(name, kind, tuple(read_source(path, name, Layout()).columns))


def _recognise_text(name: str, head: bytes) -> Recognised | None:
    if b"\0" in head:
        return None
    found = look_at_text(head)
    if not found.lines:
        return None
    layout = Layout(
        format="text", separator=found.separator, decimal=found.decimal, header=found.has_header, comment=found.comment
    )
    cells = [split_row(line, found.separator) for line in found.lines]
    if not found.has_header and len(cells[0]) > 1:
        columns = tuple(str(number) for number in range(1, len(cells[0]) + 1))
        example, told = dict(zip(columns, cells[0], strict=True)), _names_in_comment(found.comments, columns)
        guess = {} if told else _guess(cells)
        widths = tuple(map(len, cells))
        return Recognised(name, "a table without a header", columns, layout, example, told, guess, widths)
    spelled = {";": "semicolons", "tab": "tabs", "space": "blanks"}.get(found.separator)
    kind = "a table" if spelled is None else f"a table whose columns are separated by {spelled}"
    first = cells[min(1, len(cells) - 1)]
    layout = Layout() if spelled is None and not found.comment else layout
    return Recognised(name, kind, tuple(cells[0]), layout, dict(zip(cells[0], first, strict=False)))


def _names_in_comment(comments: Sequence[str], columns: Sequence[str]) -> dict[str, str]:
    """Return the number of each column by the name that the last comment gives it in which a star's coordinates are named."""
    for comment in reversed(comments):
        plain = _UNIT.sub("", comment)
        for separator in (",", ";", "tab", "space"):
            names = split_row(plain, separator)
            if len(names) == len(columns) == len(set(names)) and {"row", "col"} <= _matched(names).keys():
                return dict(zip(names, columns, strict=True))
    return {}


def _guess(rows: Sequence[Sequence[str]]) -> dict[str, str]:
    """Return the columns, by number, that hold frames, times and coordinates as far as their cells look like it.

    A time begins with its day, or is a number of a clock that never falls; whole numbers that never fall, and repeat, are frames;
    the first two others that hold fractions, and nothing below zero or beyond a detector, are x and y: those whose largest is no
    magnitude come first.
    """
    guess: dict[str, str] = {}
    numbers: dict[str, FloatArray] = {}
    for number, cells in enumerate(zip(*(row for row in rows if len(row) == len(rows[0])), strict=True), 1):
        if all(_DAY.match(cell) for cell in cells):
            guess.setdefault("time" if all(len(cell) > _DAY_LENGTH for cell in cells) else "day", str(number))
            continue
        with suppress(ValueError):
            values = np.array([float(cell.replace(",", ".")) for cell in cells])
            if np.isfinite(values).any():
                numbers[str(number)] = values[np.isfinite(values)]
    wholes = {column for column, values in numbers.items() if np.all(values == np.floor(values))}
    rising = [column for column, values in numbers.items() if np.all(np.diff(values) >= 0)]
    clocks = [column for column in rising if _find_clock(numbers[column], is_whole=column in wholes) is not None]
    if clocks:
        guess.setdefault("time", clocks[0])
    counts = [column for column in rising if column in wholes - set(clocks) and np.any(np.diff(numbers[column]) == 0)]
    if counts and len(rows[0]) > _COORDINATES:
        guess["frame"] = next((column for column in counts if np.ptp(numbers[column]) > 0), counts[0])
    places = [
        column
        for column, values in numbers.items()
        if column not in wholes | set(clocks) and np.all((values >= 0) & (values < _LARGEST_PX))
    ]
    likely = [column for column in places if numbers[column].max() > _FAINTEST]
    if len(places) >= _COORDINATES:
        guess["col"], guess["row"] = (likely if len(likely) >= _COORDINATES else places)[:_COORDINATES]
    return guess


def _find_clock(values: FloatArray, *, is_whole: bool) -> TimeForm | None:
    """Return how numbers are written that may be times of today's decades."""
    for form, (first, last) in _CLOCKS.items():
        if np.all((values >= first) & (values < last)) and not (form == "mjd" and is_whole):
            return form
    return None


def _recognise_json(path: Path, name: str, start: bytes) -> Recognised | None:
    """Return what JSON with lists or objects inside holds; of a line for each star only its columns."""
    document = _first_object(path, start)
    if document is None:
        return None
    apart = [key for key, value in document.items() if isinstance(value, list) and value]
    if not apart and not any(isinstance(value, dict) for value in document.values()):
        return Recognised(name, "JSON", tuple(document), Layout(), {key: str(value) for key, value in document.items()})
    known = [
        one.layout.explode for one in BUILT_IN.values() if one.layout.explode and set(one.layout.explode) <= set(apart)
    ]
    nested = [key for key in apart if isinstance(document[key][0], dict | list)]
    chosen = known[0] if known else tuple(nested[:1] or apart)
    layout = Layout(format="json", explode=chosen)
    columns = [key for key, value in document.items() if not isinstance(value, list | dict)]
    example: dict[str, str] = {key: str(document[key]) for key in columns}
    for key in chosen:
        for inner, value in _inside(key, document[key][0]):
            columns.append(inner)
            example[inner] = str(value)
    return Recognised(name, "nested JSON", tuple(columns), layout, example)


def _inside(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the columns that an entry of a list gives."""
    parts = value.items() if isinstance(value, dict) else enumerate(value, 1) if isinstance(value, list) else None
    yield from ((f"{key}.{name}", item) for name, item in parts) if parts is not None else ((key, value),)


def _first_object(path: Path, start: bytes) -> dict[str, Any] | None:
    """Return the first object of JSON Lines, of a list, or the one that a document is."""
    line = start.split(b"\n", 1)[0]
    try:
        found = parse_json(line)
    except ValueError:
        if path.stat().st_size > _MOST_JSON_BYTES:
            return None
        text = path.read_bytes().removeprefix(BYTE_ORDER_MARK)
        try:
            found = parse_json(text)
        except ValueError:
            found = parse_json(text.split(b"\n", 1)[0])
    found = found[0] if isinstance(found, list) and found else found
    return found if isinstance(found, dict) else None


@dataclass(frozen=True)
class Draft:
    """A first profile, and what is still to be told of it."""

    profile: Profile
    still: tuple[str, ...]


def draft_profile(found: Recognised) -> Draft:
    """Return the built-in profile that fits a file, or one drafted from its columns' names.

    Raises RefusedInputError where no columns look like coordinates.
    """
    if (fitting := found.profile) is not None:
        return Draft(fitting, ())
    columns = found.told or {column: column for column in found.columns}
    named, wide = (dict(found.guess), None) if found.guess else _find_names(tuple(columns))
    names = {quantity: columns.get(name, name) for quantity, name in named.items()}
    if "row" not in names or "col" not in names:
        raise RefusedInputError(
            f"{found.name} is {found.kind} with {', '.join(found.columns[:_SHOWN]) or 'no columns'}; no column looks like "
            "a star's row or column: define them in a mapping profile (see docs/how-to/map-my-telemetry.md).",
            code="columns-not-recognised",
        )
    still: list[str] = []
    if found.guess:
        kinds = {"col": "x", "row": "y", "frame": "the frame", "time": "the time"}
        taken = join_words([f"column {names[kind]} for {what}" for kind, what in kinds.items() if kind in names])
        taken = taken.replace(" for x", " is taken for x", 1)
        still.append(f"which column is which: the file has no column names; from the values, {taken}")
    if found.told:
        still.append(f"whether its comment names the columns correctly: {', '.join(found.told)}")
    time = None if "time" not in names else _drafted_time(names["time"], found.example, still)
    profile = Profile(
        name="mine",
        description=f"Drafted from the columns of {Path(found.name).name}.",
        layout=found.layout,
        wide=wide,
        frames=_drafted_frames(names, found, wide, still),
        row=Axis(column=names["row"]),
        col=Axis(column=names["col"]),
        time=time,
        star_id=None if "star_id" not in names else StarId(column=names["star_id"]),
        directions=_drafted_directions(names, still),
        quaternion=_drafted_quaternion(columns, still),
        magnitude=_drafted_magnitude(names),
        sigma=None if "sigma" not in names else Sigma(columns=(names["sigma"],)),
        temperature=None if "temperature" not in names else Temperature(column=names["temperature"]),
    )
    still.insert(
        0, "row.origin and col.origin: what the file calls the centre of the first pixel (0 is assumed, FITS says 1)"
    )
    if found.guess or {_plain(named[axis].rpartition(".")[2]) for axis in ("row", "col")} & set(_OF_AN_IMAGE):
        still.insert(1, "row and col: whether y counts rows downwards (row.reversed where it grows upwards)")
    if time is None and "day" in names:
        still.append(
            f"time: column {names['day']} has only days; write day and time of day in one cell, or give --time"
        )
    elif time is None:
        still.append("time: not in the file; give it on import (--time, Taken at), or its column")
    return Draft(profile, tuple(still))


def _plain(name: str) -> str:
    """Return a column's name as small letters, digits and the place of a star's number."""
    return re.sub(r"[^a-z0-9{}]", "", name.casefold())


def _find_names(columns: Sequence[str]) -> tuple[dict[str, str], Wide | None]:
    """Return the column of each quantity, of a wide table with `{n}` in it, and how wide it is."""
    names = _matched(columns)
    if "row" in names and "col" in names:
        return names, None
    numbered: dict[str, list[int]] = {}
    for column in columns:
        if (found := _NUMBERED.match(column)) is not None:
            numbered.setdefault(f"{found.group(1)}{{n}}{found.group(3)}", []).append(int(found.group(2)))
    templates = {one: numbers for one, numbers in numbered.items() if one.count("{") == 1}
    stars = _matched(templates, numbered=True)
    if "row" not in stars or "col" not in stars:
        return names, None
    numbers = templates[stars["row"]]
    return names | stars, Wide(count=len(numbers), first=min(numbers))


def _matched(columns: Sequence[str] | Mapping[str, Any], *, numbered: bool = False) -> dict[str, str]:
    """Return the column of each quantity by its synonyms."""
    plain: dict[str, str] = {}
    for column in columns:
        for form in _forms(column, numbered=numbered):
            plain.setdefault(form, column)
    found = {}
    for quantity, words in _SYNONYMS.items():
        word = next((word for word in words if word in plain), None)
        if word is not None:
            found[quantity] = plain[word]
    return found


def _forms(column: str, *, numbered: bool) -> Iterator[str]:
    """Yield how a name is looked up: whole, and as the last part of a qualified one; `{n}` and `star` left out."""
    whole = _plain(column)
    last = _plain(re.split(r"[/ .:]", column)[-1])
    for form in (whole, last):
        yield re.sub(r"^(star|s|obj|det|centroid)?\{n\}|\{n\}$", "", form) if numbered else form


def _drafted_time(column: str, example: Mapping[str, str], still: list[str]) -> Time:
    cell = example.get(column, "")
    if re.fullmatch(r"\s*[-+]?[0-9]+([.,][0-9]*)?\s*", cell):
        value = float(cell.replace(",", "."))
        form = _find_clock(np.array([value]), is_whole=value.is_integer()) or "seconds"
        assumed = {"jd": "Julian dates, UTC,", "mjd": "modified Julian dates, UTC,"}.get(
            form, f"{form} from 1970, UTC,"
        )
        still.append(f"time.system and time.form: what its numbers count, and from when ({assumed} are assumed)")
        return Time(column=column, form=form)
    return Time(column=column)


def _drafted_frames(names: Mapping[str, str], found: Recognised, wide: Wide | None, still: list[str]) -> Frames:
    if wide is not None or found.layout.explode:
        return Frames(by="record")
    exposure = names.get("exposure")
    if "frame" in names:
        cell = found.example.get(names["frame"], "0")
        by: Numbering = "column" if re.fullmatch(r"[-+]?[0-9]+(\.0*([eE][-+]?[0-9]+)?)?|", cell.strip()) else "name"
        return Frames(by=by, column=names["frame"], exposure=exposure)
    if "time" in names:
        still.append("frames: a new one at every new time is assumed")
        return Frames(by="time", exposure=exposure)
    still.append("frames: the whole file is taken for one")
    return Frames(by="file", exposure=exposure)


def _drafted_directions(names: Mapping[str, str], still: list[str]) -> Directions | None:
    if "ra" not in names or "dec" not in names:
        return None
    still.append("directions.kind: apparent, or catalogue (ICRS), which is assumed")
    return Directions(ra=names["ra"], dec=names["dec"], kind="catalogue")


def _drafted_quaternion(columns: Mapping[str, str], still: list[str]) -> Quaternion | None:
    plain = {_plain(name): column for name, column in columns.items()}
    for words in _QUATERNIONS:
        if all(word in plain for word in words):
            still.append(
                "quaternion.order, sense and convention: x y z w from ICRS to the detector, Hamilton's, is assumed"
            )
            return Quaternion(columns=tuple(plain[word] for word in words))
    return None


def _drafted_magnitude(names: Mapping[str, str]) -> Magnitude | None:
    if "magnitude" in names:
        return Magnitude(column=names["magnitude"])
    return Magnitude(column=names["flux"], kind="flux") if "flux" in names else None


def recognise_for_import(path: Path, name: str) -> Recognised:
    """Return what table a file is; refuses one that is none, for what its reader says where that names the cause."""
    found = recognise_table(path, name)
    if found is None:
        read_head(path)
        with expanded(path, name, LIMITS) as place:
            format_at(place, name)
        raise RefusedInputError(
            f"{name} is not a table that can be imported: give a table of stars, or images to `boresight extract`."
        )
    return found
