"""Every operation, asked with what its schema allows and with what it does not: schemathesis makes the requests up.

Half of the numbers that a request names are replaced by those of things that there are, and half of the tags by those that these
have now: a made-up number names nothing, and nothing behind the first look would ever be asked.
"""

from __future__ import annotations

import random
import re
from typing import Any
from urllib.parse import quote

import hypothesis
import requests
from hypothesis import HealthCheck, Phase
from schemathesis import APIOperation, Case, GenerationMode

from tests.fuzz.judge import Asker, Tally
from tests.fuzz.world import SHUTS_OUT, World

KIND = "operations"
HITS = 0.7  # share of the numbers that name something
QUIET = list(HealthCheck)


def fuzz_operation(world: World, operation: APIOperation, asker: Asker, count: int, seed: int, tally: Tally) -> None:
    random_ = random.Random(f"{seed} {operation.label} {asker.name}")
    for mode, share in ((GenerationMode.POSITIVE, count - count // 2), (GenerationMode.NEGATIVE, count // 2)):
        if share:
            _drawn(world, operation, asker, mode, share, random_, tally)


def _drawn(
    world: World,
    operation: APIOperation,
    asker: Asker,
    mode: GenerationMode,
    count: int,
    random_: random.Random,
    tally: Tally,
) -> None:
    goal = tally.requests + count

    @hypothesis.seed(random_.randrange(1 << 32))
    @hypothesis.settings(
        max_examples=count,
        phases=[Phase.generate],
        database=None,
        deadline=None,
        suppress_health_check=QUIET,
        derandomize=False,
    )
    @hypothesis.given(case=operation.as_strategy(generation_mode=mode))
    def ask(case: Case) -> None:
        if tally.requests < goal:
            send(world, case, asker, random_, tally)

    try:
        ask()
    except hypothesis.errors.Unsatisfiable:
        pass  # an operation that takes nothing cannot be asked wrongly
    except Exception as error:
        if type(error).__module__.partition(".")[0] not in {"schemathesis", "hypothesis"}:
            raise


def send(world: World, case: Case, asker: Asker, random_: random.Random, tally: Tally) -> None:
    try:
        request = case.as_transport_kwargs(base_url=world.house.address)
        _aim(world, case.operation, request, random_)
        answer = asker.send(request, whole=case.operation.path != "/api/v1/events")
    except (requests.RequestException, UnicodeError, ValueError) as error:
        if isinstance(error, requests.ConnectionError | requests.Timeout):
            tally.server_errors.append(f"{case.operation.label}: {error}")
        tally.unsendable += 1
        return
    tally.judge(KIND, asker, case, request, answer)
    answer.close()


def _aim(world: World, operation: APIOperation, request: dict[str, Any], random_: random.Random) -> None:
    path = operation.path
    names = re.findall(r"{(\w+)}", path)
    if names and (path.endswith(SHUTS_OUT) or random_.random() < HITS):
        filled = {name: world.number(name, path, random_) for name in names}
        given = dict(zip(names, _given(path, request["url"]), strict=False))
        parts = {name: quote(str(filled[name] if filled[name] is not None else given.get(name, "1"))) for name in names}
        if "name" in parts and random_.random() < HITS:
            parts["name"] = random_.choice(("radial", "parameters", "rms-axes", "rms", "convergence"))
        request["url"] = world.house.address + path.format(**parts)
        headers = request.get("headers") or {}
        if "If-Match" in headers and random_.random() < HITS:
            headers["If-Match"] = (
                random_.choice(('"v1"', '"v2"', '"v3"', '"v0"')) if len(names) > 1 else _tag(world, path, parts)
            )
    for holder in (request.get("params"), request.get("json")):
        if isinstance(holder, dict):
            _aim_members(world, path, holder, random_)


def _aim_members(world: World, path: str, holder: dict[str, Any], random_: random.Random) -> None:
    for name in holder:
        number = world.number(name, path, random_)
        if number is not None and random_.random() < HITS:
            holder[name] = number


def _given(path: str, url: str) -> list[str]:
    pattern = re.sub(r"{\w+}", "(.*)", re.escape(path).replace(r"\{", "{").replace(r"\}", "}"))
    found = re.search(f"{pattern}$", url)
    return list(found.groups()) if found else []


def _tag(world: World, path: str, parts: dict[str, str]) -> str:
    noun = path[: path.index("}") + 1]
    answer = world.read(noun.format(**parts).removeprefix("/api/v1/"))
    return str(answer.headers.get("etag", '"v1"'))
