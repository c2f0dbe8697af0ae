"""A route that is built by the first request for it, beside one that is built as it is declared."""

import threading
import time
from typing import Annotated

import httpx
import pytest
from fastapi import APIRouter, Depends, FastAPI
from fastapi.routing import APIRoute

from boresight.platform.web.lazy_route import LazyRoute
from boresight.server import ROUTES
from tests.sites import Visitor


def half(number: int = 4) -> float:
    return number / 2


def declare(kind):
    router = APIRouter(prefix="/numbers", route_class=kind, tags=["numbers"])

    @router.get("/{number}", summary="Read")
    def read(number: int, part: Annotated[float, Depends(half)]) -> dict[str, float]:
        return {"number": number, "half": part}

    @router.post("", status_code=201)
    def make(number: int) -> int:
        return number

    return FastAPI(routes=router.routes), router.routes


def is_built(route):
    return "dependant" in vars(route)


def test_a_route_is_built_by_the_first_request_for_it_and_by_no_other():
    app, (read, make) = declare(LazyRoute)
    visitor = Visitor(app, "", httpx.Cookies())
    assert visitor.send("GET", "/elsewhere").status_code == 404
    assert visitor.send("PUT", "/numbers/3").status_code == 405
    assert not is_built(make)
    assert visitor.send("GET", "/numbers/3").json() == {"number": 3, "half": 1.5}
    assert is_built(read)
    assert not is_built(make)
    assert visitor.send("POST", "/numbers?number=x").status_code == 422
    assert visitor.send("POST", "/numbers?number=5").status_code == 201
    assert app.url_path_for("read", number=7) == "/numbers/7"


def test_a_lazy_route_is_described_as_an_ordinary_one():
    assert declare(LazyRoute)[0].openapi() == declare(APIRoute)[0].openapi()


def test_many_that_ask_at_once_find_one_whole_route():
    _, (read, _make) = declare(LazyRoute)
    start, found = threading.Barrier(8), []

    def ask():
        start.wait()
        found.append(read.app)

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert len(found) == 8
    assert len(set(map(id, found))) == 1


def test_a_route_that_could_not_be_built_is_built_by_the_next_request(monkeypatch):
    app, (read, _make) = declare(LazyRoute)
    visitor = Visitor(app, "", httpx.Cookies())
    with monkeypatch.context() as patch:
        patch.setattr(APIRoute, "get_route_handler", lambda _route: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            visitor.send("GET", "/numbers/3")
    assert not is_built(read)
    assert visitor.send("GET", "/numbers/3").json() == {"number": 3, "half": 1.5}


def test_two_routes_are_never_built_at_once(monkeypatch):
    _, routes = declare(LazyRoute)
    build, inside, most = APIRoute.__init__, [], []

    def watch(route, *given, **options):
        inside.append(route)
        most.append(len(inside))
        time.sleep(0.05)
        build(route, *given, **options)
        inside.remove(route)

    monkeypatch.setattr(APIRoute, "__init__", watch)
    threads = [threading.Thread(target=route.prepare) for route in routes]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert most == [1, 1]


def test_a_server_can_build_every_route():
    lazy = [route for route in ROUTES.routes if isinstance(route, LazyRoute)]
    for route in lazy:
        route.prepare()
    assert len(lazy) > 300
    assert all(is_built(route) for route in lazy)
