"""What a run gives to take along."""

from boresight.console.runs.tables import RunEvent
from boresight.platform.db.sessions import open_writing, utc_now


def test_the_log_is_text_a_line_an_event(site):
    with open_writing(site.engine) as session:
        session.add(RunEvent(run_id=1, attempt=2, at_utc=utc_now(), kind="lost", message="the worker died"))
    lines = site.visitor("victor").send("GET", "/runs/1/log").text.splitlines()
    assert lines[-1].endswith(" 2 lost the worker died")


def test_the_sensor_file_is_the_one_of_the_launch(site):
    run_id = site.add_run(sensor_document={"name": "as it was"})
    assert site.visitor("victor").send("GET", f"/runs/{run_id}/sensor.json").json() == {"name": "as it was"}
