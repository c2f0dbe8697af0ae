"""A link to a scheduler takes its thread with it, whether it never came, was lost or was closed."""

from __future__ import annotations

import pytest
from services import Services, listens, loops, wait_for

from benchmarks.servers import free_port
from boresight.workers.cluster import SchedulerClient


def test_a_scheduler_that_does_not_answer_costs_no_thread_however_often_it_is_asked():
    before = loops()
    for _ in range(2):
        with pytest.raises(OSError, match=r"[Tt]imed out|refused"):
            SchedulerClient(f"tcp://127.0.0.1:{free_port()}", timeout=0.2, set_as_default=False)
    assert loops() <= before


def test_a_scheduler_that_goes_away_takes_the_thread_of_its_client_along(tmp_path):
    port, before = free_port(), loops()
    services = Services(tmp_path, data_folder=str(tmp_path))
    try:
        services.start("scheduler", "--port", str(port))
        wait_for(lambda: listens(port))
        client = SchedulerClient(f"tcp://127.0.0.1:{port}", timeout=5, set_as_default=False)
        assert len(loops() - before) == 1
    finally:
        services.stop()
    wait_for(lambda: client.status == "closed")
    client.close()
    client.close()
    assert loops() <= before
