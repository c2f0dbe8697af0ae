"""A server whose PostgreSQL goes and comes back: refusals in one sentence meanwhile, and no restart of its own."""

import time
from pathlib import Path

import httpx
import sqlalchemy as sa

from boresight.platform.db.sessions import Engine
from tests.postgresql import server
from tests.served import PASSWORD, add_people, serving, settings_in

PATIENCE_S = 30


def test_requests_are_refused_while_postgresql_is_gone_and_answered_when_it_is_back(
    postgresql: Engine, tmp_path: Path
) -> None:
    url = postgresql.url.render_as_string(hide_password=False)
    settings = settings_in(tmp_path / "data", database_url=url)
    add_people(settings)
    with serving(settings) as (address, _), httpx.Client(base_url=address, timeout=30) as client:
        assert client.post("/api/v1/sessions", json={"name": "ada", "password": PASSWORD}).status_code == 201
        with postgresql.connect() as connection:
            connection.execute(sa.text("CHECKPOINT"))  # the tests' server writes no commit to disk by itself
        server().stop()
        try:
            gone = client.get("/api/v1/sensors")
            unready = client.get("/readyz")
        finally:
            server().start()
        assert (gone.status_code, gone.json()["title"]) == (503, "Unavailable")
        assert "The database does not answer" in gone.json()["detail"]
        assert unready.status_code == 503
        until_s = time.monotonic() + PATIENCE_S
        while (back := client.get("/api/v1/sensors")).status_code != 200:
            assert time.monotonic() < until_s, back.text
            time.sleep(0.1)
