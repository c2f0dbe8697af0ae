"""Documents that are nearly right: a good one with a few places changed, so that it passes the first looks and meets the last.

A place is changed to what a person, a program or an attacker might write there: nothing, another type, a number at the end of
what a double or the store holds, a text that is empty, long, of another script or a formula; members are dropped, doubled, renamed
or moved. Files are changed by cells, by lines and by bytes.
"""

from __future__ import annotations

import copy
import io
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pyarrow.csv
import pyarrow.parquet
import requests

from boresight.calibration.options import CalibrationSettings
from boresight.verdicts.gates.profile import DEFAULT_PROFILE
from tests.fuzz.judge import Asker, Tally, bare_case
from tests.fuzz.world import World
from tests.served import House

KIND = "documents"
ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 1.5, -0.0, 1e-320, 1e308, -1e308, 2**31, 2**63, 2**64, -(2**63) - 1, 10**30,
    "", " ", "0", "1", "f_m", "batch", "svd", "ÿ", "ﬁ", "\u202egnp", "e\u0301", "=1+1", "../../x", "x" * 300, "x" * 5000,
    "\U0001f6f0", "2026-11-21T03:04:05Z", "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00", "NaN",
    [], {}, [[]], [None], [1, 2, 3], [{}], {"": None}, {"name": {}}, ["f_m", "f_m"], [[1.0] * 3] * 3,
)  # fmt: skip
CELLS = (
    b"", b" ", b"0", b"-1", b"1e308", b"nan", b"inf", b"-inf", b"NULL", b"9" * 30, b"9" * 5000, b"1,5", b"0x1F", b'"', b'""""',
    b"\xff", b"\x00", b"\xed\xa0\x80", b"=1+1", "é".encode(), b"2026-11-21", b"0001-01-01T00:00:00+14:00", b"1e400", b"true",
)  # fmt: skip
MOST_FRAMES = 6


@dataclass(frozen=True)
class Kind:
    operation: str
    make: Callable[[World, random.Random], dict[str, Any]]


def places(document: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield way
    if isinstance(document, dict):
        for name, value in document.items():
            yield from places(value, (*way, name))
    elif isinstance(document, list):
        for number, value in enumerate(document):
            yield from places(value, (*way, number))


def changed(document: Any, random_: random.Random) -> Any:
    found = copy.deepcopy(document)
    for _ in range(random_.choice((1, 1, 1, 2, 3))):
        ways = [way for way in places(found) if way]
        if not ways:
            return random_.choice(ODD)
        *before, last = random_.choice(ways)
        holder = found
        for step in before:
            holder = holder[step]
        _change(holder, last, random_)
    return found


def _change(holder: Any, last: Any, random_: random.Random) -> None:
    act = random_.random()
    if act < 0.6:
        holder[last] = copy.deepcopy(random_.choice(ODD))
    elif act < 0.7:
        del holder[last]
    elif act < 0.8 and isinstance(holder, list):
        holder.append(copy.deepcopy(holder[last]))
    elif act < 0.9 and isinstance(holder, dict):
        holder[random_.choice(("x", "", "schema", f"{last}_", "ſ", "__class__"))] = holder.pop(last)
    elif isinstance(holder[last], int | float):
        holder[last] = holder[last] * random_.choice((-1, 0, 1e-12, 1e12, 1e300))
    else:
        holder[last] = [holder[last]]


def _sensor(world: World, random_: random.Random) -> dict[str, Any]:
    return {"json": changed(world.house.sensor_file(), random_)}


def _edited(world: World, random_: random.Random) -> dict[str, Any]:
    number = random_.choice(world.ids["sensor_id"])
    row = world.read(f"sensors/{number}").json()
    return {"path": {"sensor_id": number}, "json": changed(row["document"], random_), "tag": f'"v{row["version"]}"'}


def _gates(world: World, random_: random.Random) -> dict[str, Any]:
    body = changed({"gates": copy.deepcopy(DEFAULT_PROFILE["gates"][4:8])}, random_)
    return {"path": {"sensor_id": random_.choice(world.ids["sensor_id"])}, "json": body}


def _gates_in_force(world: World, random_: random.Random) -> dict[str, Any]:
    made = _gates(world, random_)
    if isinstance(made["json"], dict):
        made["json"].setdefault("reason", "Tried.")
    number = made["path"]["sensor_id"]
    listed = world.read(f"sensors/{number}/gate-profiles?limit=1")
    return {**made, "tag": listed.headers.get("etag", '"v1"').removeprefix("W/")}


def _table(world: World, random_: random.Random) -> dict[str, Any]:
    number = random_.choice(world.ids["sensor_id"])
    row = world.read(f"sensors/{number}").json()
    fields = [
        {
            "name": f"F{place}",
            "parameter": name,
            "offset_bytes": 4 * place,
            "type": random_.choice(("float32", "int32")),
        }
        for place, name in enumerate(row["document"]["initial"])
    ]
    crc = {"name": "CRC-16/CCITT-FALSE", "offset_bytes": 4 * len(fields)}
    document = {
        "table_id": "T",
        "flight_software_version": "1",
        "byte_order": "big",
        "length_bytes": 4 * len(fields) + 2,
        "fields": fields,
        "crc": crc,
    }
    body = {"document": changed(document, random_), "reason": "Tried."}
    tag = world.read(f"sensors/{number}/table-definitions?limit=1").headers.get("etag", '"v0"')
    return {"path": {"sensor_id": number}, "json": body, "tag": tag.removeprefix("W/")}


def _settings(random_: random.Random) -> Any:
    return changed(
        {**CalibrationSettings().document(), "method": random_.choice(("batch", "sqrf", "svd", "ekf"))}, random_
    )


def _launch(world: World, random_: random.Random) -> dict[str, Any]:
    run = random_.choice(world.pairs)
    body = {"sensor_id": run[0], "telemetry_set_id": run[1], "settings": _settings(random_), "validate_only": True}
    return {"json": body if random_.random() < 0.7 else changed(body, random_)}


def _preset(_world: World, random_: random.Random) -> dict[str, Any]:
    return {"json": {"name": f"P{random_.randrange(50)}", "sentence": "Tried.", "settings": _settings(random_)}}


def _campaign(world: World, random_: random.Random) -> dict[str, Any]:
    sensors = [{"sensor_id": random_.choice(world.ids["sensor_id"])} for _ in range(2)]
    body = {"label": "Tried", "sensors": sensors, "settings": _settings(random_), "validate_only": True}
    return {"json": changed(body, random_)}


def _upload(world: World, random_: random.Random) -> dict[str, Any]:
    content, name = _file(world.house, random_)
    fields = {
        "sensor_id": str(random_.choice(world.ids["sensor_id"])),
        "purpose": random_.choice(("calibration", "validation")),
    }
    if random_.random() < 0.1:
        fields[random_.choice(tuple(fields))] = random_.choice(("", "9" * 30, "9" * 5000, "x", "-1", "\ud7ff", "٣"))
    query = {"validate_only": "true"} if random_.random() < 0.8 else {}
    return {"data": fields, "files": {"file": (name, content)}, "params": query}


def _file(house: House, random_: random.Random) -> tuple[bytes, str]:
    lines = [line.split(b",") for line in house.telemetry_csv.splitlines()]
    frames = sorted({int(line[0].strip(b'"')) for line in lines[1:]})[:MOST_FRAMES]
    kept = [lines[0], *(line for line in lines[1:] if int(line[0].strip(b'"')) in frames)]
    for _ in range(random_.choice((0, 1, 1, 2, 5))):
        row = random_.choice(kept) if random_.random() < 0.8 else kept[0]
        row[random_.randrange(len(row))] = random_.choice(CELLS)
    act = random_.random()
    if act < 0.1:
        del kept[random_.randrange(len(kept))]
    elif act < 0.2:
        random_.shuffle(kept)
    elif act < 0.3:
        kept = [row[:-1] for row in kept] if random_.random() < 0.5 else [[*row, b"1"] for row in kept]
    content, name = b"\n".join(b",".join(row) for row in kept) + b"\n", "t.csv"
    shape = random_.random()
    if shape < 0.2:
        content, name = _as_parquet(content), "t.parquet"
    elif shape < 0.3:
        content, name = _as_lines(content), "t.jsonl"
    if random_.random() < 0.2 and content:
        content = _torn(content, random_)
    return content, random_.choice((name, name, name, "", "x" * 300, "\u202et.csv", "t.fits", "../t.csv"))


def _as_parquet(content: bytes) -> bytes:
    try:
        table = pyarrow.csv.read_csv(io.BytesIO(content))
        out = io.BytesIO()
        pyarrow.parquet.write_table(table, out)
    except (pyarrow.ArrowException, ValueError, OSError, UnicodeError):
        return content
    return out.getvalue()


def _as_lines(content: bytes) -> bytes:
    head, *rows = content.splitlines()
    names = [name.strip(b'"') for name in head.split(b",")]
    return b"\n".join(
        b"{"
        + b",".join(b'"' + name + b'":' + (cell or b"null") for name, cell in zip(names, row.split(b","), strict=False))
        + b"}"
        for row in rows
    )


def _torn(content: bytes, random_: random.Random) -> bytes:
    place = random_.randrange(len(content))
    return random_.choice(
        (
            content[:place],
            content[place:],
            content[:place] + bytes([random_.randrange(256)]) + content[place + 1 :],
            content[:place] + content[:100] + content[place:],
        )
    )


def _dump(world: World, random_: random.Random) -> dict[str, Any]:
    number = random_.choice(world.ids["parameter_set_id"])
    tag = world.read(f"parameter-sets/{number}").headers["etag"]
    fields = {
        "source": "TM",
        "crc": random_.choice(("", "FFFF", "0x1", "zz", "9" * 5000)),
        "happened_utc": random_.choice(("", "0001-01-01T00:00:00+14:00", "2026-01-01", "x")),
    }
    files = {"file": ("d.bin", random_.randbytes(random_.choice((0, 1, 34, 300))))} if random_.random() < 0.7 else None
    if files is None:
        files = {"other": (None, "x")}
    return {"path": {"parameter_set_id": number}, "data": fields, "files": files, "tag": tag.removeprefix("W/")}


KINDS = (
    Kind("register_sensor", _sensor),
    Kind("edit_sensor", _edited),
    Kind("try_gate_profile", _gates),
    Kind("set_gate_profile", _gates_in_force),
    Kind("set_table_definition", _table),
    Kind("launch_run", _launch),
    Kind("save_preset", _preset),
    Kind("launch_campaign", _campaign),
    Kind("upload_telemetry_set", _upload),
    Kind("read_back", _dump),
)


def fuzz_document(world: World, kind: Kind, asker: Asker, count: int, seed: int, tally: Tally) -> None:
    random_ = random.Random(f"{seed} {kind.operation} {asker.name}")
    operation = world.operations[kind.operation]
    for _ in range(count):
        made = kind.make(world, random_)
        url = world.house.address + operation.path.format(**made.get("path", {}))
        headers = {"If-Match": made["tag"]} if "tag" in made else {}
        request = {"method": operation.method.upper(), "url": url, "headers": headers}
        request |= {name: made[name] for name in ("json", "data", "files", "params") if name in made}
        try:
            answer = asker.send(request)
        except (requests.RequestException, UnicodeError, ValueError) as error:
            if isinstance(error, requests.ConnectionError | requests.Timeout):
                tally.server_errors.append(f"{operation.label}: {error}")
            tally.unsendable += 1
            continue
        path = {name: str(number) for name, number in made.get("path", {}).items()}
        tally.judge(KIND, asker, bare_case(operation, path_parameters=path), request, answer)
