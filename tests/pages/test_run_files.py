"""What a run gives to take along."""

from __future__ import annotations

from boresight.store.sessions import utc_now, writing
from boresight.store.tables import RunEvent


def test_the_report_is_one_file_to_keep(house):
    answer = house.visitor("victor").send("GET", "/runs/1/report")
    assert answer.status_code == 200
    assert answer.headers["content-disposition"] == 'attachment; filename="run-1-report.html"'
    assert "ST16-1" in answer.text


def test_a_run_without_a_result_has_no_report(house):
    assert house.visitor("victor").send("GET", f"/runs/{house.add_run()}/report").status_code == 409


def test_the_log_is_text_a_line_an_event(house):
    with writing(house.engine) as session:
        session.add(RunEvent(run_id=1, attempt=2, at_utc=utc_now(), kind="lost", message="the worker died"))
    lines = house.visitor("victor").send("GET", "/runs/1/log").text.splitlines()
    assert lines[-1].endswith(" 2 lost the worker died")


def test_the_sensor_file_is_the_one_of_the_launch(house):
    run_id = house.add_run(sensor_document={"name": "as it was"})
    assert house.visitor("victor").send("GET", f"/runs/{run_id}/sensor.json").json() == {"name": "as it was"}
