"""How far a set turns the attitude is seen on its page and by the approver, before anything is signed."""

import pytest

ALIGNMENT = {
    "quaternion": [0.0, 1e-5, 0.0, 1.0],
    "rotation_arcsec": [0.0, 4.1, -1234.5],
    "sigma_arcsec": [0.4, 0.7, None],
    "sigma_of_mean_arcsec": [0.1, 0.1, 0.2],
    "frames": 10,
    "scatter_arcsec": 1.0,
    "noise_arcsec": 2.0,
    "consistent": True,
    "sentence": "Loading these parameters turns the reported attitude by 4.1 ± 0.1 arcsec about y.",
    "c_sd_update": [[1.0, 0.0, -2e-5], [0.0, 1.0, 0.0], [2e-5, 0.0, 1.0]],
}


@pytest.fixture
def place_of(site, results):
    def place(alignment):
        run = site.add_run("batch", state="SUCCEEDED", result={**results["batch"], "alignment": alignment})
        return site.visitor("ada").post(f"/runs/{run}/parameter-set").headers["location"]

    return place


def requested(site, place):
    ada = site.visitor("ada")
    version = ada.get(place).split('name="version" value="')[1].split('"')[0]
    return ada.post(f"{place}/submit", version=version, reason="Better.").headers["location"]


def test_the_page_of_a_set_and_of_its_request_show_rotation_uncertainty_and_update(site, place_of, read):
    place = place_of(ALIGNMENT)
    for address in (place, requested(site, place)):
        text = read(site.visitor("alan").get(address))
        assert ALIGNMENT["sentence"] in text
        assert "over 10 frames" in text
        assert "y, along the columns 4.1 0.1 0.7 arcsec" in text
        assert "0.000020000" in text
        assert "old C_SD × this matrix" in text


def test_the_alignment_is_read_before_the_signature(site, place_of):
    page = site.visitor("alan").get(requested(site, place_of(ALIGNMENT)))
    assert page.index('id="change-title"') < page.index('id="alignment-title"') < page.index('id="sign-title"')


def test_a_rotation_that_changes_through_the_set_is_a_caution(site, place_of):
    def notices(alignment):
        return site.visitor("victor").get(place_of(alignment)).count('class="notice notice-caution"')

    assert notices(ALIGNMENT | {"consistent": False}) == notices(ALIGNMENT) + 1


def test_a_set_without_one_says_why(site, place_of, read):
    assert "its run compared no attitudes" in read(site.visitor("victor").get(place_of(None)))
    assert "a ground calibration turns nothing" in read(site.visitor("victor").get("/parameter-sets/1"))


def test_a_baseline_that_was_calibrated_itself_is_a_caution_for_the_next(site, place_of, read):
    first = place_of(ALIGNMENT)
    address = requested(site, first)
    site.visitor("alan").post(
        f"{address}/sign",
        version="1",
        password="correct horse battery",
        decision="APPROVE",
        meaning="Good.",
        comment="",
    )
    olga = site.visitor("olga")
    olga.post(f"{first}/promote", version=olga.get(first).split('name="version" value="')[1].split('"')[0])
    assert "PS-ST16-1-1 is no ground calibration" in read(olga.get(place_of(ALIGNMENT | {"frames": 11})))
