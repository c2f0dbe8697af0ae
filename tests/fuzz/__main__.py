"""`make fuzz REQUESTS=100000`: ask every operation as three identities, and say what came of it."""

from __future__ import annotations

import argparse
import json
import logging
import sys
import tempfile
import time
from pathlib import Path

from boresight.sky.catalogue import load_catalogue
from tests.fuzz.judge import Tally
from tests.fuzz.run import fuzz
from tests.fuzz.world import furnished
from tests.served import house_in

TELL_EVERY_S = 30


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument("--requests", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="where the counts are written")
    given = parser.parse_args()
    logging.getLogger("boresight").setLevel(logging.ERROR)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        with house_in(place, load_catalogue(place / "catalogue")) as house:
            world = furnished(house)
            began_s, told_s = time.monotonic(), [0.0]

            def tell(tally: Tally, seconds: float) -> None:
                if seconds - told_s[0] > TELL_EVERY_S:
                    told_s[0] = seconds
                    print(f"{seconds:6.0f} s  {tally.requests} requests, {len(tally.failures)} failures", flush=True)

            tally = fuzz(world, given.requests, given.seed, tell)
            seconds = time.monotonic() - began_s
            world.close()
    summary = {**tally.summary(), "seconds": round(seconds, 1), "seed": given.seed}
    for failure in tally.failures[:200]:
        print(f"\n{failure}")
    print(json.dumps(summary, indent=2))
    if given.json:
        given.json.write_text(json.dumps({**summary, "failures": tally.failures}, indent=2))
    return 1 if tally.failures else 0


if __name__ == "__main__":
    sys.exit(main())
