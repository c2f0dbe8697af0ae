"""Over a hundred telemetry files made to exhaust whoever reads them; each is small to send, and the same every time.

`FILES` is the registry: a name with its suffix, and what writes the bytes. What a file tries stands in its name.
"""

import io
from collections.abc import Callable

import numpy as np
import pyarrow as pa
import pyarrow.parquet as arrow_parquet

HEAD = "frame,exposure,row_px,col_px"
GOOD_JSON = b'{"frame":0,"exposure":0,"row_px":1,"col_px":2'
#: Rows of the files that are many rows.
MANY = 300_000

Make = Callable[[np.random.Generator], bytes]
FILES: dict[str, Make] = {}


def file(name: str) -> Callable[[Make], Make]:
    def register(make: Make) -> Make:
        assert name not in FILES
        FILES[name] = make
        return make

    return register


def content(name: str) -> bytes:
    return FILES[name](np.random.default_rng(sorted(FILES).index(name)))


def add(name: str, data: bytes | Callable[[], bytes]) -> None:
    file(name)(lambda _: data if isinstance(data, bytes) else data())


def csv(head: str, row: Callable[[int], str], rows: int = MANY) -> bytes:
    return "\n".join([head, *map(row, range(rows))]).encode()


def column_csv(column: str, cell: str, rows: int = MANY) -> bytes:
    return csv(f"{HEAD},{column}", lambda k: f"{k // 20},0,{k % 700}.{k % 20:02},{k % 900},{cell}", rows)


def wide(columns: int) -> str:
    return ",".join([HEAD, *(f"c{k}" for k in range(columns))])


def add_rows(name: str, row: Callable[[int], str], rows: int = MANY, more: str = "") -> None:
    add(name, lambda: csv(HEAD + more, row, rows))


# Text: names, lines, quotes, line ends, encodings.
for columns, told in ((100_000, "100,000"), (997, "1,001")):
    add(f"header of {told} columns.csv", lambda columns=columns: f"{wide(columns)}\n0,0,1,2\n".encode())
add("header of quoted names.csv", lambda: (HEAD + ',"a,b"' * 90_000).encode() + b"\n0,0,1,2\n")
add("header of one name repeated.csv", lambda: (HEAD + ",c" * 400_000).encode() + b"\n0,0,1,2\n")
add("header without names.csv", lambda: HEAD.encode() + b"," * 900_000 + b"\n0,0,1,2\n")
add("column name of 100 kB.csv", f"{HEAD},{'n' * 100_000}\n0,0,1,2,3\n".encode)
add("column name of 500 kB.csv", f"{HEAD},{'n' * 500_000}\n0,0,1,2,3\n".encode)
add("column name in quotes of 500 kB.csv", f'{HEAD},"{"n" * 500_000}"\n0,0,1,2,3\n'.encode)
add("names that turn direction.csv", lambda: csv(f"{HEAD},\u202e\u2066\u0000x", lambda k: f"{k},0,1,2,3"))
add("900 columns of texts.csv", lambda: csv(wide(900), lambda k: f"{k},0,1,2" + ",ab" * 900, 4000))
add("996 columns of nothing.csv", lambda: csv(wide(996), lambda _: "0,0,1,2" + "," * 996, 10_000))
add("cell of 20 MB.csv", f"{HEAD},note\n0,0,1,2,{'x' * 20_000_000}\n".encode)
add("cell of 20 MB in quotes.csv", f'{HEAD},note\n0,0,1,2,"{"x" * 20_000_000}"\n'.encode)
add("cells of 900 kB.csv", lambda: csv(f"{HEAD},note", lambda k: f"{k},0,1,2,{'x' * 900_000}", 20))
add("digits without a line end.csv", lambda: b"1" * 30_000_000)
add("number of 4,000 digits.csv", lambda: column_csv("magnitude", "9" * 4000, 2000))
add("number of 900,000 digits.csv", lambda: column_csv("star_id", "9" * 900_000, 20))
add("number with 1e999999.csv", lambda: column_csv("magnitude", "1e999999"))
add("number with leading zeros.csv", lambda: column_csv("star_id", "0" * 1000 + "7", 10_000))
add("integers in hexadecimal.csv", lambda: column_csv("star_id", "0x7FFFFFFFFFFFFFFF"))
add("integers beyond 64 bit.csv", lambda: column_csv("star_id", "99999999999999999999"))
add("integers as floats.csv", lambda: column_csv("star_id", "9007199254740993.0"))
add("quote that does not end.csv", lambda: column_csv("note", "a").replace(b",a\n", b',"a\n', 1))
add("every quote unclosed.csv", lambda: column_csv("note", '"a'))
add("nothing but quotes.csv", lambda: HEAD.encode() + b"\n" + b'"' * 900_000 + b"\n" + b'"' * 900_001)
add("quotes within cells.csv", lambda: column_csv("note", 'a""b"c'))
add("quotes and commas.csv", lambda: HEAD.encode() + b"\n" + b'"a,",' * 180_000)
add("nothing but commas.csv", lambda: b"," * 900_000 + b"\n" + b"," * 900_000)
add("lines of commas.csv", lambda: HEAD.encode() + b"\n" + b",,,\n" * 1_000_000)
add("NUL in every row.csv", lambda: column_csv("note", "a\0b"))
add("NUL for numbers.csv", lambda: column_csv("magnitude", "\0"))
add("nothing but NUL.csv", lambda: b"\0" * 20_000_000)
add("mixed line ends.csv", lambda: column_csv("note", "a").replace(b"7\n", b"7\r\n").replace(b"a\n", b"a\r", 1000))
add("carriage returns only.csv", lambda: column_csv("note", "a").replace(b"\n", b"\r"))
add("blank lines at the end.csv", lambda: HEAD.encode() + b"\n0,0,1,2" + b"\n" * 20_000_000)
add("blank lines between.csv", lambda: HEAD.encode() + b"\n" * 7_000_000 + b"0,0,1,2\n")
add("blank lines forever.csv", lambda: HEAD.encode() + b"\n" * 20_000_000 + b"0,0,1,2\n")
add("spaces.csv", lambda: b" " * 20_000_000)
add("spaces after a header.csv", lambda: HEAD.encode() + b"\n" + b" " * 20_000_000)
add("UTF-16.csv", lambda: column_csv("note", "a").decode().encode("utf-16"))
add("UTF-16 without a mark.csv", lambda: column_csv("note", "a").decode().encode("utf-16-le"))
add("UTF-32.csv", lambda: column_csv("note", "a", 100_000).decode().encode("utf-32"))
add("byte-order marks.csv", lambda: b"\xef\xbb\xbf" * 1_000_000 + HEAD.encode() + b"\n0,0,1,2\n")
add("not UTF-8 at the end.csv", lambda: column_csv("note", "a") + b"\xff")
add("surrogates in UTF-8.csv", lambda: column_csv("note", "x").replace(b"x", b"\xed\xa0\x80"))
add("overlong UTF-8.csv", lambda: column_csv("note", "x").replace(b"x", b"\xc0\xaf"))
add_rows("rows of too few cells.csv", lambda k: f"{k},0,1")
add("formulas.csv", lambda: column_csv("=cmd|' /C calc'!A0", "=1+1"))

# What rows say together.
add_rows("a frame a row.csv", lambda k: f"{k},0,{k % 700},3", 1_000_000)
add_rows("an exposure a row.csv", lambda k: f"0,{k},{k % 700},3", 900_000)
add_rows("a frame without end.csv", lambda k: f"0,{k // 9},{k % 9},3", 1_200_000)
add_rows("an exposure of all stars.csv", lambda k: f"0,0,{k}.5,3", 900_000)
add_rows("exposures of 10,000 stars in a line.csv", lambda k: f"{k // 10_000},0,5.0,{3 * (k % 10_000)}", 600_000)
add_rows(
    "exposures of 10,000 stars in a heap.csv", lambda k: f"{k // 10_000},0,5.{k % 100:02},3.{k % 10_000:04}", 600_000
)
add_rows(
    "exposures of 10,000 stars on a grid.csv",
    lambda k: f"{k // 10_000},0,{2.5 * (k % 100)},{2.5 * (k // 100 % 100)}",
    600_000,
)
add_rows("one centroid for all.csv", lambda k: f"{k // 10_000},0,5,3")
add_rows("one star for all.csv", lambda k: f"{k // 10_000},0,{k % 10_000},3,11767", more=",star_id")
add_rows("exposures torn apart.csv", lambda k: f"0,{k % 2},{k},3")
add_rows("frames that descend.csv", lambda k: f"{-k},0,5,3")
add_rows(
    "frames at the ends of 64 bit.csv", lambda k: f"{(-1) ** (k < 1000) * (2**63 - 2000 + k)},{2**63 - 1},5,3", 2000
)
add("stars off the detector.csv", lambda: column_csv("star_id", "11767").replace(b".00,", b"99.0,"))
add_rows("centroids at the ends of floats.csv", lambda k: f"{k},0,{(-1) ** k}e308,{(-1) ** k * 1.7}e308")
add_rows("directions at the ends of floats.csv", lambda k: f"{k},0,1,2,1e308,-1e308", more=",ra_deg,dec_deg")
add_rows(
    "velocities at the ends of floats.csv", lambda k: f"{k},0,1,2,1e308,1e308,1e308", more=",vx_km_s,vy_km_s,vz_km_s"
)
add("magnitudes at the ends of floats.csv", lambda: column_csv("magnitude", "1e308"))
add("sigmas that are no numbers in effect.csv", lambda: column_csv("sigma_px", "1e-320"))
add_rows("quaternions of nothing.csv", lambda k: f"{k},0,1,2,0,0,0,0", more=",q_x,q_y,q_z,q_w")
add_rows("quaternions without a number.csv", lambda k: f"{k},0,1,2,nan,inf,-inf,1", more=",q_x,q_y,q_z,q_w")
add_rows("quaternions without an end.csv", lambda k: f"{k},0,1,2,1e200,1e200,1e200,1e200", more=",q_x,q_y,q_z,q_w")
add("times at the ends of the calendar.csv", lambda: column_csv("time_utc", "0001-01-01T00:00:00+14:00"))
add("times after the calendar.csv", lambda: column_csv("time_utc", "9999-12-31T23:59:59.999999-14:00"))
add_rows("times that are none, all different.csv", lambda k: f"{k},0,1,2,{k}-13-41Tx", more=",time_utc")
add_rows("times all different.csv", lambda k: f"{k},0,1,2,2026-01-01T00:00:00.{k:06}Z", more=",time_utc")

# JSON Lines.
add("arrays nested on a line.jsonl", lambda: GOOD_JSON + b',"x":' + b"[" * 400_000 + b"]" * 400_000 + b"}\n")
add("arrays nested over lines.jsonl", lambda: GOOD_JSON + b',"x":' + b"[\n" * 1_000_000 + b"]\n" * 1_000_000 + b"}\n")
add("objects nested.jsonl", lambda: GOOD_JSON + b',"x":' + b'{"a":' * 150_000 + b"1" + b"}" * 150_000 + b"}\n")
add("arrays that do not end.jsonl", lambda: GOOD_JSON + b'}\n{"a":' + b"[" * 900_000)
add("one key repeated.jsonl", lambda: GOOD_JSON + b',"x":1' * 150_000 + b"}\n")
add("100,000 keys.jsonl", lambda: GOOD_JSON + b"".join(b',"%d":1' % k for k in range(80_000)) + b"}\n")
add(
    "a thousand keys, then empty lines.jsonl",
    lambda: GOOD_JSON + b"".join(b',"%d":1' % k for k in range(990)) + b"}\n" + b"{}\n" * 1_000_000,
)
add("a key a line.jsonl", lambda: b"".join(b'{"k%d":1}\n' % k for k in range(200_000)))
add("empty objects.jsonl", lambda: b"{}\n" * 1_500_000)
add("objects on one line.jsonl", lambda: (GOOD_JSON + b"}") * 15_000)
add("lone surrogates.jsonl", lambda: (GOOD_JSON + b',"\\ud800":"\\udfff"}\n') * 50_000)
add("integer of 5,000 digits.jsonl", lambda: (GOOD_JSON + b',"star_id":' + b"9" * 5000 + b"}\n") * 200)
add("number with 1e999999.jsonl", lambda: (GOOD_JSON + b',"magnitude":1e999999}\n') * 50_000)
add("NaN with 5,000 digits.jsonl", lambda: (GOOD_JSON + b',"a":NaN,"star_id":' + b"9" * 5000 + b"}\n") * 200)
add("string of 20 MB.jsonl", lambda: GOOD_JSON + b',"x":"' + b"x" * 20_000_000 + b'"}\n')
add("strings of escapes.jsonl", lambda: (GOOD_JSON + b',"x":"' + b"\\u0000" * 150_000 + b'"}\n') * 10)
add("lists of nothing.jsonl", lambda: (GOOD_JSON + b',"x":[' + b"[]," * 300_000 + b"[]]}\n") * 8)
add("arrays for objects.jsonl", lambda: b"[1,2,3]\n" * 700_000)
add("keys without a name.jsonl", lambda: (GOOD_JSON + b',"":1}\n') * 50_000)
add("brackets.jsonl", lambda: b"[\n" * 2_000_000)


# Parquet.
def parquet(columns: dict[str, object] | pa.Table, **options: object) -> bytes:
    sink = io.BytesIO()
    table = columns if isinstance(columns, pa.Table) else pa.table(columns)
    arrow_parquet.write_table(table, sink, **({"compression": "zstd"} | options))
    return sink.getvalue()


def make_rows(rows: int) -> dict[str, object]:
    k = np.arange(rows)
    return {"frame": k // 20, "exposure": np.zeros(rows, np.int64), "row_px": (k % 20) * 1.5, "col_px": (k % 700) * 1.0}


def with_column(rows: int, column: str, cells: object, **options: object) -> bytes:
    return parquet({**make_rows(rows), column: cells}, **options)


def text_column(length: int, rows: int) -> pa.Array:
    return pa.DictionaryArray.from_arrays(np.zeros(rows, np.int32), pa.array(["x" * length]))


def varint(value: int) -> bytes:
    value, out = value << 1, bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def patched(data: bytes, old: int, new: int) -> bytes:
    assert len(varint(old)) == len(varint(new))
    assert varint(old) in data
    return data.replace(varint(old), varint(new))


def flipped(data: bytes, rng: np.random.Generator, flips: int, footer_only: bool = False) -> bytes:
    changed = bytearray(data)
    first = len(data) - 8 - int.from_bytes(data[-8:-4], "little") if footer_only else 4
    for place in rng.integers(first, len(data) - 8, flips).tolist():
        changed[place] ^= 1 << int(rng.integers(8))
    return bytes(changed)


for length in (1000, 4000, 10_000, 100_000):
    add(
        f"text of {length} bytes in a million rows.parquet",
        lambda length=length: with_column(1_000_000, "note", text_column(length, 1_000_000)),
    )
add(
    "text for numbers in a million rows.parquet",
    lambda: with_column(1_000_000, "magnitude", text_column(4000, 1_000_000)),
)
add(
    "texts of a million kinds.parquet",
    lambda: with_column(1_000_000, "note", pa.array(map(str, range(1_000_000)))),
)
add(
    "texts compressed a thousandfold.parquet",
    lambda: with_column(60_000, "note", ["x" * 4000] * 60_000, use_dictionary=False),
)
add(
    "texts by their differences.parquet",
    lambda: with_column(
        60_000, "note", ["x" * 4000] * 60_000, use_dictionary=False, column_encoding={"note": "DELTA_BYTE_ARRAY"}
    ),
)
add("text of 60 MB.parquet", lambda: with_column(1, "note", ["x" * 60_000_000]))
add(
    "page of 400 MB.parquet",
    lambda: parquet(
        {"frame": np.zeros(50_000_000, np.int8)},
        use_dictionary=False,
        data_page_size=1_000_000_000,
        row_group_size=60_000_000,
        max_rows_per_page=100_000_000,
    ),
)
add(
    "rows beyond number.parquet",
    lambda: parquet({"frame": pa.array(np.zeros(60_000_000, np.int8)), "exposure": pa.nulls(60_000_000)}),
)
add("rows that are not there.parquet", lambda: patched(parquet(make_rows(40_000)), 40_000, 1_000_000))
add(
    "pages larger than they are.parquet",
    lambda: patched(
        parquet(
            {"frame": np.zeros(200_000, np.int64)},
            use_dictionary=False,
            compression="zstd",
            data_page_size=10_000_000,
            max_rows_per_page=200_000,
        ),
        1_600_008,
        130_000_000,
    ),
)
add(
    "columns of nothing.parquet",
    lambda: parquet(pa.table({**make_rows(200_000), **{f"c{k}": pa.nulls(200_000) for k in range(900)}})),
)
add("columns beyond number.parquet", lambda: parquet({f"c{k}": [1] for k in range(20_000)}))
add("1,001 columns.parquet", lambda: parquet({**make_rows(2), **{f"c{k}": [1, 2] for k in range(997)}}))
add("name of 1 MB.parquet", lambda: parquet({**make_rows(2), "n" * 1_000_000: [1, 2]}))
add("one name repeated.parquet", lambda: parquet(pa.Table.from_arrays([pa.array([1, 2])] * 900, names=["frame"] * 900)))
add("groups of a row.parquet", lambda: parquet(make_rows(4_000), row_group_size=1))
add("pages of a row.parquet", lambda: parquet(make_rows(20_000), max_rows_per_page=1, use_dictionary=False))
add("no rows.parquet", lambda: parquet(make_rows(0)))
add("footer of 30 MB.parquet", lambda: parquet(pa.table(make_rows(2)).replace_schema_metadata({"x": "y" * 30_000_000})))
add("lists of a million.parquet", lambda: with_column(2, "note", [[1] * 1_000_000, []]))
add("nested structs.parquet", lambda: with_column(1, "note", pa.array([nested(40)])))
add(
    "maps.parquet",
    lambda: with_column(2, "note", pa.array([[("a", 1)], []], pa.map_(pa.string(), pa.int64()))),
)
add("decimals.parquet", lambda: with_column(2, "magnitude", pa.array([1, 2], pa.decimal256(76, 0))))
add(
    "bytes of a fixed length.parquet",
    lambda: with_column(50_000, "note", pa.array([b"x" * 1000] * 50_000, pa.binary(1000))),
)
add("bytes that are no text.parquet", lambda: with_column(100_000, "note", pa.array([b"\xff\xfe"] * 100_000)))
add(
    "times of nanoseconds at their ends.parquet",
    lambda: with_column(2, "time_utc", pa.array([-(2**63) + 1, 2**63 - 1], pa.timestamp("ns"))),
)
add("truth for numbers.parquet", lambda: with_column(100_000, "magnitude", pa.array([True, False] * 50_000)))
add("half a file.parquet", lambda: parquet(make_rows(100_000))[:50_000])
add("encrypted in name.parquet", lambda: b"PARE" + parquet(make_rows(100))[4:-4] + b"PARE")
add("footer longer than the file.parquet", lambda: parquet(make_rows(100))[:-8] + b"\xff\xff\xff\x7fPAR1")
for flips in (1, 4, 64):
    file(f"{flips} bits flipped.parquet")(lambda rng, flips=flips: flipped(parquet(make_rows(100_000)), rng, flips))
    file(f"{flips} bits flipped in the footer.parquet")(
        lambda rng, flips=flips: flipped(parquet(make_rows(100_000)), rng, flips, footer_only=True)
    )
file("noise.parquet")(lambda rng: b"PAR1" + rng.bytes(5_000_000) + b"\0\x10\0\0PAR1")
file("noise.csv")(lambda rng: rng.integers(1, 128, 5_000_000, np.uint8).tobytes())
file("noise.jsonl")(lambda rng: b"{" + rng.integers(1, 128, 5_000_000, np.uint8).tobytes())


def nested(depth: int) -> dict[str, object]:
    return {"a": nested(depth - 1)} if depth else {"a": 1}
