"""What the cluster does beside tasks: little, and nothing for pages that are not there; and who may speak to it."""

import gc
import os
import sys
import threading
import time

import dask
import pytest
from cryptography import x509
from distributed import Client, get_worker
from distributed.gc import disable_gc_diagnosis, enable_gc_diagnosis

from boresight.workers.cluster import Cluster, Nanny

SELDOM_MS = {"tick": 1000.0, "monitor": 5000.0}  # at the least between two


@pytest.fixture(scope="module")
def cluster(make_store):
    opened = Cluster.open(make_store(workers="2").settings, lambda _report: None)
    yield opened
    opened.close(())


def every_ms(server):
    return {name: callback.callback_time for name, callback in server.periodic_callbacks.items()}


@pytest.mark.full
def test_a_worker_does_not_look_at_its_computing_thread(cluster):
    done, _ = cluster._client.run(
        lambda dask_worker: {name: each.callback_time for name, each in dask_worker.periodic_callbacks.items()}
    ).values()
    assert not {name for name in done if name.startswith("profile")}
    assert all(done[name] >= least for name, least in SELDOM_MS.items())
    assert done["memory_monitor"] <= 500.0  # what takes too much memory is found before it is twice that


@pytest.mark.full
def test_a_worker_keeps_the_memory_that_it_will_need_again(cluster):
    thresholds = cluster._client.run(os.environ.get, "MALLOC_TRIM_THRESHOLD_").values()
    assert set(thresholds) == {None}, "every array of 64 kB would be given back and come again in pages that fault"


@pytest.mark.full
def test_the_scheduler_and_the_nannies_leave_the_server_its_processor(cluster):
    nannies = list(cluster._local.workers.values())
    assert [type(nanny) for nanny in nannies] == [Nanny, Nanny]
    for server in (cluster._local.scheduler, *nannies):
        assert all(every_ms(server)[name] >= least for name, least in SELDOM_MS.items())
    assert "stealing" not in every_ms(cluster._local.scheduler)
    assert not cluster._local.scheduler.extensions["amm"].running


def test_every_link_of_our_own_workers_is_encrypted_and_asks_both_ends_who_they_are(cluster):
    servers = [cluster._local.scheduler, *cluster._local.workers.values()]
    assert all(server.address.startswith("tls://127.0.0.1:") for server in servers)
    assert all(address.startswith("tls://127.0.0.1:") for address in cluster.workers())
    assert not any(server.services for server in servers)  # no port beside the link


def test_a_worker_fetches_what_another_has_over_their_own_link(cluster):
    one, two = sorted(cluster.workers())
    held = cluster._client.submit(bytes, 1000, workers=[one], pure=False)
    told = cluster._client.submit(lambda it: (len(it), get_worker().address), held, workers=[two], pure=False)
    assert told.result(60) == (1000, two)


def test_the_key_of_the_workers_is_in_no_configuration_no_log_and_no_description(cluster):
    client = cluster._client
    texts = [str(dask.config.config), repr(cluster._local.security), str(client.scheduler_info())]
    texts += map(str, client.run(lambda: (str(dask.config.config), dict(os.environ))).values())
    texts += map(str, [client.get_worker_logs(), client.get_scheduler_logs(), client.get_events()])
    assert not [text for text in texts if "PRIVATE KEY" in text]


@pytest.mark.full
def test_the_certificate_of_the_workers_outlasts_every_server_and_each_server_has_its_own(cluster, make_store):
    security = cluster._local.security
    for pem in (security.tls_ca_file, security.tls_worker_cert):
        certificate = x509.load_pem_x509_certificate(pem.encode())
        assert certificate.not_valid_before_utc.timestamp() < time.time() - 20 * 365 * 86_400  # whatever the clock says
        assert certificate.not_valid_after_utc.year == 9999
    other = Cluster.open(make_store(workers="1").settings, lambda _report: None)
    try:
        with pytest.raises(OSError, match=r"TLS|in time|closed|Timed"):
            Client(cluster._local.scheduler.address, security=other._local.security, timeout=2, set_as_default=False)
    finally:
        other.close(())


class SlowGarbage:
    """An object that is found by a collection only, and takes its time to go."""

    def __init__(self, found, may_go):
        self.itself, self.found, self.may_go = self, found, may_go

    def __del__(self):
        self.found.set()
        self.may_go.wait()


def test_a_scheduler_that_starts_during_a_collection_of_another_thread_raises_nothing_there(monkeypatch):
    raised, found, may_go = [], threading.Event(), threading.Event()
    monkeypatch.setattr(sys, "unraisablehook", raised.append)

    def start_scheduler():  # as far as diagnosis goes
        found.wait()
        enable_gc_diagnosis()
        may_go.set()

    other = threading.Thread(target=start_scheduler)
    other.start()
    SlowGarbage(found, may_go)
    gc.collect()
    other.join()
    disable_gc_diagnosis()
    assert not raised
