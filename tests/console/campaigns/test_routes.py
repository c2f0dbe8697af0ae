"""Campaigns and presets over REST: queued once, dry-run, followed, stopped, and a dry run of a run that foretells."""

import pytest

from tests.console.campaigns import campaigns
from tests.served import House


def test_a_dry_run_foretells_the_sigmas_that_the_run_then_has(house: House) -> None:
    sensor_id, set_id = house.ready_sensor()
    order = {"sensor_id": sensor_id, "telemetry_set_id": set_id, "settings": {"method": "batch"}, "validate_only": True}
    said = house.person("ada").post("/api/v1/runs", json=order).json()
    forecast = said["forecast"]
    assert forecast["sentence"].startswith("8 parameters, ")
    assert forecast["weak"] == sum(sigma > 0.5 for sigma in house.result["observability"]["sigma_of_direction"])
    for name, sigma in house.result["sigma"].items():
        assert forecast["sigma"][name] == pytest.approx(sigma, rel=0.1)
    low, high = said["predicted_range_s"]
    assert low <= said["predicted_s"] <= high


def test_a_campaign_is_launched_once_under_one_key_and_followed_where_it_says(house: House) -> None:
    client = house.key("ada", "runs")
    order = campaigns.launch(house)[1]
    first, second = (client.post("/api/v1/campaigns", **order, headers={"Idempotency-Key": "one"}) for _ in range(2))
    assert (first.status_code, second.json()) == (202, first.json())
    assert second.headers["idempotent-replayed"] == "true"
    read = client.get(first.headers["location"])
    assert (read.json()["state"], read.json()["counts"]["QUEUED"], read.json()["fraction"]) == ("UNDER WAY", 1, 0.0)
    lines = client.get(first.headers["location"] + "/results").json()["items"]
    run = client.get(f"/api/v1/runs/{lines[0]['run_id']}").json()
    assert (run["label"], run["state"]) == ("Monday", "QUEUED")


def test_a_key_without_the_scope_launches_no_campaign(house: House) -> None:
    client = house.key("ada", "telemetry-sets")
    answer = client.post("/api/v1/campaigns", **campaigns.launch(house)[1])
    assert answer.status_code == 403
    assert "lacks the scope runs" in answer.json()["detail"]


def test_a_dry_run_of_a_campaign_names_who_would_be_left_out(house: House) -> None:
    bare, ready = house.new_sensor(), house.ready_sensor()[0]
    order = campaigns.launch(house, sensors=[{"sensor_id": bare["id"]}, {"sensor_id": ready}], validate_only=True)[1]
    said = house.person("ada").post("/api/v1/campaigns", **order).json()
    assert (said["sensors"], said["runs"]) == (2, 1)
    assert said["refused"] == [
        {
            "sensor_id": bare["id"],
            "sensor": bare["name"],
            "refusal": f"{bare['name']} has no calibration set; upload one and launch it again.",
        }
    ]


def test_a_preset_is_chosen_by_its_key_and_settings_go_over_its_own(house: House) -> None:
    number = campaigns.preset(house)[1]["preset_id"]
    _, options = campaigns.campaign(house, preset=str(number), settings={"minimum_stars": 5})
    read = house.person("victor").get(f"/api/v1/campaigns/{options['campaign_id']}").json()
    assert (read["settings"]["robust"], read["settings"]["minimum_stars"]) == ("huber", 5)
    assert read["preset"].endswith("version 1")


def test_cancelling_a_campaign_ends_its_runs_and_moves_its_tag(house: House) -> None:
    _, options = campaigns.campaign(house)
    client, address = house.person("ada"), f"/api/v1/campaigns/{options['campaign_id']}"
    stopped = client.post(f"{address}:cancel", headers=options["headers"], json={"reason": "Monday is over."})
    assert (stopped.status_code, stopped.json()["state"]) == (200, "CANCELLED")
    assert stopped.headers["etag"] != options["headers"]["If-Match"]
    line = client.get(f"{address}/results").json()["items"][0]
    assert (line["state"], "Monday is over." in line["reason"]) == ("CANCELLED", True)
    assert client.post(f"{address}:cancel", headers={"If-Match": stopped.headers["etag"]}).status_code == 409


def test_results_come_in_pages(house: House) -> None:
    sensors = [{"sensor_id": house.ready_sensor()[0]} for _ in range(3)]
    _, options = campaigns.campaign(house, sensors=sensors)
    client, address = house.person("victor"), f"/api/v1/campaigns/{options['campaign_id']}/results"
    first = client.get(address, params={"limit": 2}).json()
    second = client.get(address, params={"limit": 2, "cursor": first["next"]}).json()
    assert [line["sensor_id"] for line in (*first["items"], *second["items"])] == [one["sensor_id"] for one in sensors]
    assert second["next"] is None


def test_boresights_presets_come_first_and_archived_ones_only_where_asked(house: House) -> None:
    _, options = campaigns.preset(house)
    client = house.person("ada")
    listed = client.get("/api/v1/presets").json()["items"]
    client.post(f"/api/v1/presets/{options['preset_id']}:archive", headers=options["headers"])
    assert listed[0]["key"] == "first-calibration"
    assert listed[0]["id"] is None
    keys = [
        {one["key"] for one in client.get("/api/v1/presets", params=asked).json()["items"]}
        for asked in ({}, {"archived": True})
    ]
    assert str(options["preset_id"]) not in keys[0]
    assert str(options["preset_id"]) in keys[1]


def test_what_a_campaign_writes_to_the_logs_of_its_runs_is_chained(house: House) -> None:
    who, options = campaigns.campaign(house)
    client = house.person(who)
    assert client.get("/api/v1/audit/verification").json()["ok"]
    address = f"/api/v1/campaigns/{options['campaign_id']}:cancel"
    assert client.post(address, json={"reason": "Enough."}, headers=options["headers"]).status_code == 200
    found = client.get("/api/v1/audit/verification").json()
    assert found["ok"], found["sentence"]
