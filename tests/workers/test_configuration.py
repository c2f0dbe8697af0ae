"""What the cluster does beside tasks: little, and nothing for pages that are not there."""

import os

import pytest
from distributed import Nanny

from boresight.workers.cluster import Cluster

SELDOM_MS = {"tick": 1000.0, "monitor": 5000.0}  # at the least between two


@pytest.fixture(scope="module")
def cluster(make_store):
    """Open a cluster of one worker."""
    opened = Cluster.open(make_store(workers="1").settings, lambda _report: None)
    yield opened
    opened.close(())


def every_ms(server):
    """Return what a server of distributed does again and again, and how often."""
    return {name: callback.callback_time for name, callback in server.periodic_callbacks.items()}


def test_a_worker_does_not_look_at_its_computing_thread(cluster):
    (done,) = cluster._client.run(
        lambda dask_worker: {name: each.callback_time for name, each in dask_worker.periodic_callbacks.items()}
    ).values()
    assert not {name for name in done if name.startswith("profile")}
    assert all(done[name] >= least for name, least in SELDOM_MS.items())
    assert done["memory_monitor"] <= 500.0  # what takes too much memory is found before it is twice that


def test_a_worker_keeps_the_memory_that_it_will_need_again(cluster):
    (threshold,) = cluster._client.run(os.environ.get, "MALLOC_TRIM_THRESHOLD_").values()
    assert threshold is None, "every array of 64 kB would be given back and come again in pages that fault"


def test_the_scheduler_and_the_nannies_leave_the_server_its_processor(cluster):
    nannies = list(cluster._local.workers.values())
    assert [type(nanny) for nanny in nannies] == [Nanny]
    for server in (cluster._local.scheduler, *nannies):
        assert all(every_ms(server)[name] >= least for name, least in SELDOM_MS.items())
    assert "stealing" not in every_ms(cluster._local.scheduler)
    assert not cluster._local.scheduler.extensions["amm"].running
