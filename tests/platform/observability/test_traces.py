"""Traces: one from the click to the stored result, over processes, as a stand-in for a collector decodes it from OTLP over HTTP."""

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest

from benchmarks.receivers import collecting_spans
from boresight.platform.observability.traces import NO_SPAN, Traces, read_traceparent
from tests.served import House, add_people, serving, settings_in

TRACE = "0af7651916cd43dd8448eb211c80319c"
PATIENCE_S = 240.0
STAGES = {"arcs", "fit", "judge"}


class Collector:
    """What is behind an OTLP/HTTP endpoint."""

    def __init__(self, url: str, spans: list[tuple[str, Any]]) -> None:
        self.url, self.spans = url, spans

    def of(self, trace_id: str) -> list[tuple[str, Any]]:
        return [(service, span) for service, span in self.spans if span.trace_id.hex() == trace_id]


@pytest.fixture(scope="module")
def collector() -> Iterator[Collector]:
    with collecting_spans() as (url, spans):
        yield Collector(url, spans)


def _attributes(span: Any) -> dict[str, Any]:
    return {one.key: getattr(one.value, one.value.WhichOneof("value")) for one in span.attributes}


def test_one_trace_leads_from_the_click_to_the_result_over_server_queue_and_worker(
    collector, house, catalogue, tmp_path
):
    settings = settings_in(tmp_path / "data", workers="1", otlp_endpoint=collector.url)
    add_people(settings)
    with serving(settings, catalogue) as (address, app):
        own = House(address, app, house.telemetry_csv, {})
        sensor_id, set_id = own.ready_sensor()
        own.person("ada").headers["traceparent"] = f"00-{TRACE}-b7ad6b7169203331-01"
        form: dict[str, str] = {
            "intent": "queue",
            "sensor_id": str(sensor_id),
            "telemetry_set_id": str(set_id),
            "method": "batch",
        }
        form |= {f"free-{sensor_id}": "f_m"}
        form["csrf_token"] = own.person("ada").headers["X-CSRF-Token"]
        clicked = own.person("ada").post("/runs/new", data=form)
        assert clicked.status_code == 303, re.findall("notice[^>]*>.*", clicked.text)
        del own.person("ada").headers["traceparent"]
        run_id = int(clicked.headers["location"].rpartition("/")[2])
        _wait_for(lambda: own.person("ada").get(f"/api/v1/runs/{run_id}").json()["state"] == "SUCCEEDED")
        _wait_for(lambda: {"run", "compute", "store result"} <= {span.name for _, span in collector.of(TRACE)})
        for client in own.opened:
            client.close()
    told = {span.name: (service, span) for service, span in collector.of(TRACE)}
    ids = {span.span_id: name for name, (_, span) in told.items()}
    tree = {name: ids.get(span.parent_span_id) for name, (_, span) in told.items()}
    click = "POST /runs/new"
    assert {name: tree[name] for name in (click, "queue", "run", "compute", "store result")} == {
        click: None,
        "queue": click,
        "run": click,
        "compute": "run",
        "store result": "compute",
    }
    assert {name for name, parent in tree.items() if parent == "compute"} >= STAGES
    assert told[click][1].parent_span_id.hex() == "b7ad6b7169203331", "the browser's or the caller's own span"
    assert {name: told[name][0] for name in (click, "run", "compute")} == {
        click: "boresight",
        "run": "boresight",
        "compute": "boresight-worker",
    }
    run = _attributes(told["run"][1])
    assert (run["boresight.run_id"], run["boresight.sensor_id"], run["boresight.state"]) == (
        run_id,
        sensor_id,
        "SUCCEEDED",
    )
    assert len(run["boresight.result_sha256"]) == 64
    assert _attributes(told[click][1])["boresight.person"] == "ada"
    times = {name: (span.start_time_unix_nano, span.end_time_unix_nano) for name, (_, span) in told.items()}
    assert times["run"][0] <= times["compute"][0] <= times["compute"][1] <= times["run"][1]
    assert (
        sum(end - begin for begin, end in (times[stage] for stage in STAGES))
        <= times["compute"][1] - times["compute"][0]
    )


def _wait_for(holds: Any) -> None:
    begun_s = time.monotonic()
    while not holds():
        assert time.monotonic() - begun_s < PATIENCE_S
        time.sleep(0.2)


def test_without_an_endpoint_nothing_that_makes_or_sends_spans_is_imported_and_a_span_is_nothing():
    making = ("opentelemetry.sdk", "opentelemetry.exporter")  # the framework imports the names alone, where they are
    words = f"import sys, boresight.server; print(sorted(m for m in sys.modules if m.startswith({making})))"
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    traces = Traces()
    with traces.span("x") as span:
        assert span is NO_SPAN
    assert not traces.on


@pytest.mark.parametrize(
    "text",
    ["", "00-0-0-00", f"00-{'0' * 32}-{'1' * 16}-01", f"00-{TRACE}-{'0' * 16}-01", f"00-{TRACE}-b7ad6b7169203331-01\n"],
)
def test_what_is_no_traceparent_begins_a_trace_of_its_own(text):
    assert read_traceparent(text) is None
