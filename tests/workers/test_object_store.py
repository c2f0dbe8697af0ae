"""Workers that share no folder with the server: they get an address, fetch what they need, and put what they found."""

import hashlib
import json
import shutil

import obstore
import pytest
from obstore.store import from_url

from boresight.platform.blobs.locations import BlobLocation
from boresight.platform.blobs.opening import open_blobs
from tests.object_store import SECRET, serving_s3

BUCKET = "s3://flight/blobs"


@pytest.fixture(scope="module")
def flying(make_store, start_dispatcher, tmp_path_factory):
    with serving_s3("flight"), pytest.MonkeyPatch.context() as environment:
        own = tmp_path_factory.mktemp("worker")
        environment.setenv("BORESIGHT_DATA_FOLDER", str(own))
        store = make_store(blobs=BUCKET, workers="1")
        start_dispatcher(store)
        yield store, own


def test_a_run_is_computed_from_the_bucket_and_its_result_is_there(flying, tmp_path):
    store, own = flying
    (run_id,) = store.launch("quick")
    assert store.wait_until_ended([run_id]) == ["SUCCEEDED"], store.run(run_id).reason
    elsewhere = open_blobs(BlobLocation(BUCKET, tmp_path, 10**9))
    result = json.loads(elsewhere.read(store.run(run_id).result_sha256))
    assert result["sensor"] == f"quick-{run_id}"
    assert any((own / "blob-cache").rglob("*")), "the worker kept nothing of its own"
    assert not (store.settings.data_folder / "blobs").exists()


def test_a_file_that_is_missing_from_the_bucket_ends_the_run_with_that_sentence(flying):
    store, own = flying
    shutil.rmtree(own / "blob-cache")
    table = next(store.settings.data_folder.glob("table.parquet"))
    sha256 = hashlib.sha256(table.read_bytes()).hexdigest()
    obstore.delete(from_url(BUCKET, client_options={"allow_http": True}), f"{sha256[:2]}/{sha256[2:4]}/{sha256}")
    (run_id,) = store.launch("quick")
    assert store.wait_until_ended([run_id]) == ["FAILED"]
    assert "from s3://flight/blobs" in store.run(run_id).reason
    assert SECRET not in " ".join(store.log(run_id, "log"))
