"""The watched bucket, on a real S3 server in this process: each version once, by the limits of the folder, and never written."""

import dataclasses
import hashlib

import obstore
import pytest
from obstore.store import from_url

from boresight.console.ingest.bucket import ArrivedObject, WatchedBucket
from boresight.console.jobs.ingest_watcher import IngestWatcher
from boresight.errors import RefusedInputError, UnavailableError
from boresight.platform.audit import log as audit
from boresight.platform.db.sessions import open_reading
from boresight.settings import read_settings
from tests.console.ingest.decisions import in_force, recent_csv
from tests.object_store import serving_s3

ADDRESS = "s3://downlink/passes"
LARGE = 1_000_000


@pytest.fixture(scope="module")
def s3():
    with serving_s3("downlink") as address:
        yield address


@pytest.fixture
def store(s3):
    """The bucket as those who deliver to it see it, empty."""
    assert s3
    client = from_url(ADDRESS, client_options={"allow_http": True})
    obstore.delete(client, [one["path"] for listed in obstore.list(client) for one in listed])
    return client


def _new(bucket, *sensors):
    return [(one.sensor, one.name, one.size_bytes) for one in bucket.list_new([*sensors])]


def test_objects_of_the_sensors_are_listed_and_others_are_left_alone(store):
    for key in ("ST-1/a.csv", "ST-1/.b.csv", "ST-1/c.csv.part", "ST-1/old/d.csv", "ST-10/e.csv", "f.csv"):
        obstore.put(store, key, b"frame")
    bucket = WatchedBucket(ADDRESS, 0)
    assert _new(bucket, "ST-1", "ST-2") == [("ST-1", "a.csv", 5)]
    assert (bucket.count_waiting("ST-1"), bucket.count_waiting("ST-2")) == (1, 0)
    bucket.note_known(bucket.list_new(["ST-1"])[0])
    assert bucket.count_waiting("ST-1") == 0
    assert _new(bucket, "ST-1") == []


def test_it_is_listed_at_most_as_often_as_was_set(store):
    now_s = [0.0]
    bucket = WatchedBucket(ADDRESS, 30, clock=lambda: now_s[0])
    assert _new(bucket, "ST-1") == []
    obstore.put(store, "ST-1/a.csv", b"frame")
    now_s[0] = 29.0
    assert _new(bucket, "ST-1") == []
    now_s[0] = 30.0
    assert _new(bucket, "ST-1") == [("ST-1", "a.csv", 5)]


def test_what_is_copied_is_what_was_listed(store, tmp_path):
    obstore.put(store, "ST-1/a b.csv", b"frame" * 1000)
    bucket = WatchedBucket(ADDRESS, 0)
    (found,) = bucket.list_new(["ST-1"])
    taken = bucket.take(found, tmp_path / "copy", LARGE)
    assert (taken.size_bytes, taken.sha256) == (5000, hashlib.sha256(b"frame" * 1000).hexdigest())
    assert taken.path.read_bytes() == b"frame" * 1000
    obstore.put(store, "ST-1/a b.csv", b"other")
    assert bucket.take(found, tmp_path / "other", LARGE) is None
    (again,) = bucket.list_new(["ST-1"])
    assert (again.address, again.version == found.version) == (found.address, False)
    obstore.delete(store, "ST-1/a b.csv")
    assert bucket.take(again, tmp_path / "gone", LARGE) is None


def test_an_object_over_the_limit_is_refused_unread(s3, tmp_path):
    assert s3
    bucket = WatchedBucket(ADDRESS, 0)
    large = ArrivedObject("ST-1", "a.csv", f"{ADDRESS}/ST-1/a.csv", '"0"', 2001)
    with pytest.raises(RefusedInputError, match="BORESIGHT_UPLOAD_LIMIT_MB"):
        bucket.take(large, tmp_path / "copy", 2000)
    assert not (tmp_path / "copy").exists()


def test_the_address_is_of_a_bucket_and_holds_no_credentials():
    assert read_settings({"BORESIGHT_WATCH_BUCKET": "s3://downlink/passes/"}).watch_bucket == ADDRESS
    for text in ("/var/passes", "ftp://downlink", "s3://key:secret@downlink/passes"):
        with pytest.raises(RefusedInputError):
            read_settings({"BORESIGHT_WATCH_BUCKET": text})


@pytest.fixture
def watcher_of(house):
    def make(address=ADDRESS):
        state = house.app.state
        settings = dataclasses.replace(state.settings, watch_bucket=address, watch_bucket_s=0.0)
        return IngestWatcher(state.engine, state.forecast_sources, settings, lambda: None)

    return make


def _sensor(house, policy):
    return house.person("victor").get(f"/api/v1/sensors/{policy['sensor_id']}").json()["name"]


def _decisions(house, policy):
    query = {"sensor_id": policy["sensor_id"]}
    return house.person("victor").get("/api/v1/ingest-decisions", params=query).json()["items"][::-1]


def test_each_version_of_an_object_is_taken_once_also_by_a_server_that_was_restarted(
    house, store, watcher_of, monkeypatch
):
    policy, idle = in_force(house), house.new_sensor()["name"]
    sensor = _sensor(house, policy)
    obstore.put(store, f"{sensor}/pass-1.csv", recent_csv(house, -9))
    obstore.put(store, f"{sensor}/broken.csv", b"no telemetry")
    obstore.put(store, f"{idle}/pass-1.csv", recent_csv(house, -8))
    first = watcher_of()
    for _ in range(3):
        first.look_into_bucket()
    found = {row["file_name"]: (row["source"], row["state"]) for row in _decisions(house, policy)}
    assert found == {"pass-1.csv": ("BUCKET", "CALIBRATING"), "broken.csv": ("BUCKET", "REFUSED")}
    assert first.count_waiting(sensor) == 0

    fetched = []
    take = WatchedBucket.take
    monkeypatch.setattr(WatchedBucket, "take", lambda *given: fetched.append(given[1].name) or take(*given))
    second = watcher_of()
    second.look_into_bucket()
    assert (fetched, len(_decisions(house, policy))) == ([], 2)

    obstore.put(store, f"{sensor}/copy.csv", recent_csv(house, -9))  # the same bytes
    obstore.put(store, f"{sensor}/broken.csv", recent_csv(house, -7))  # another version
    for _ in range(2):
        second.look_into_bucket()
    watcher_of().look_into_bucket()
    assert sorted(fetched) == ["broken.csv", "copy.csv"]
    assert [(row["file_name"], row["state"]) for row in _decisions(house, policy)][2:] == [
        ("broken.csv", "CALIBRATING")
    ]
    kept = {one["path"] for listed in obstore.list(store) for one in listed}
    assert kept == {f"{sensor}/{name}" for name in ("pass-1.csv", "copy.csv", "broken.csv")} | {f"{idle}/pass-1.csv"}
    with open_reading(house.app.state.engine) as session:
        assert audit.verify(session).ok


def test_too_many_objects_pause_the_policy(house, store, watcher_of):
    policy = in_force(house, sets_per_day=1)
    for day in (-6, -5):
        obstore.put(store, f"{_sensor(house, policy)}/pass{day}.csv", recent_csv(house, day))
    watcher = watcher_of()
    for _ in range(2):
        watcher.look_into_bucket()
    paused = house.person("victor").get(f"/api/v1/ingest-policies/{policy['id']}").json()
    assert (paused["state"], paused["pause_code"], len(_decisions(house, policy))) == ("PAUSED", "TOO MANY SETS", 1)


def test_a_bucket_that_is_not_there_is_said_on_the_page_until_it_is(house, s3, watcher_of):
    assert s3
    in_force(house)
    watcher = watcher_of("s3://elsewhere/passes")
    watcher.look_into_bucket()
    assert "s3://elsewhere/passes" in watcher.fault
    assert watcher.places == ["s3://elsewhere/passes"]
    with pytest.raises(UnavailableError, match="BORESIGHT_WATCH_BUCKET"):
        WatchedBucket("s3://elsewhere/passes", 0).list_new(["ST-1"])
