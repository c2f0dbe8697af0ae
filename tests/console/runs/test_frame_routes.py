"""Frames of a run over the API: in pages by number or worst first, and one with its residuals; who asks for none is told."""

import pytest

from tests.served import House


@pytest.fixture(scope="module")
def run_id(house: House) -> int:
    return house.finished()


def test_frames_come_in_pages_by_number(house: House, run_id: int) -> None:
    client, seen, cursor = house.person("victor"), [], None
    for _ in range(4):
        params = {"limit": 12, **({"cursor": cursor} if cursor else {})}
        page = client.get(f"/api/v1/runs/{run_id}/frames", params=params).json()
        seen += [line["frame"] for line in page["items"]]
        cursor = page["next"]
        if cursor is None:
            break
    assert seen == list(range(30))


def test_the_worst_come_first_with_what_makes_them_so(house: House, run_id: int) -> None:
    answer = house.person("victor").get(f"/api/v1/runs/{run_id}/frames", params={"order": "worst", "limit": 5}).json()
    deviations = [line["deviation"] for line in answer["items"]]
    assert deviations == sorted(deviations, reverse=True)
    assert [line["frame"] for line in answer["items"]] == house.result["trust"]["worst_frames"]["frame"][:5]
    assert house.person("victor").get(f"/api/v1/runs/{run_id}/frames", params={"order": "best"}).status_code == 422


def test_a_frame_s_residuals_are_those_the_result_keeps(house: House, run_id: int) -> None:
    kept = house.result["trust"]["residuals"]
    frame = house.person("victor").get(f"/api/v1/runs/{run_id}/frames/4").json()
    stars = {
        (star["star_id"], round(star["row_px"], 1)): star
        for exposure in frame["exposures"]
        for star in exposure["stars"]
    }
    places = [place for place, number in enumerate(kept["frame"]) if number == 4]
    assert len(places) > 5
    for place in places:
        star = stars[kept["star_id"][place], round(kept["row_px"][place], 1)]
        assert star["fate"] == "used"
        assert star["new"]["d_px"] == pytest.approx([kept["d_row_px"][place], kept["d_col_px"][place]], abs=1e-4)
    assert (frame["place"], frame["previous"], frame["next"]) == (5, 3, 5)


def test_a_run_without_a_result_is_shown_at_the_old_parameters(house: House) -> None:
    frame = house.person("victor").get(f"/api/v1/runs/{house.launched()['id']}/frames/0").json()
    assert frame["why_no_new"]
    assert frame["previous"] is None
    assert all(exposure["attitude"]["new"] is None for exposure in frame["exposures"])
    assert any(exposure["attitude"]["old"] for exposure in frame["exposures"])


@pytest.mark.parametrize(("frame", "status"), [("99", 404), ("-1", 404), ("x", 422)])
def test_a_frame_that_is_not_there_is_a_problem_with_a_sentence(
    house: House, run_id: int, frame: str, status: int
) -> None:
    answer = house.person("victor").get(f"/api/v1/runs/{run_id}/frames/{frame}")
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    if status == 404:
        assert "30 frames are numbered from 0 to 29" in answer.json()["detail"]
