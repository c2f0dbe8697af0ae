"""Hipparcos-2 is trimmed once, cached whole, and answers unknown numbers with -1."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.sky.catalogue import SINGLE_STAR, Catalogue, load_catalogue

RAD_PER_MAS = np.pi / 180 / 3.6e6
SIRIUS, ALPHA_CENTAURI, VEGA, POLARIS = 32349, 71683, 91262, 11767
XI_URSAE_MAJORIS = 55203


def star(catalogue, hip):
    return int(catalogue.find_index(np.array([hip]))[0])


def same(one, other):
    return all(np.array_equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(Catalogue))


def test_the_catalogue_goes_down_to_the_magnitude_asked_for(catalogue):
    assert len(catalogue) == 117955
    assert len(load_catalogue(None, 8.0)) == 37622
    assert len(load_catalogue(None, 6.0)) == np.count_nonzero(catalogue.magnitude <= 6.0)


def test_sirius_has_the_numbers_of_the_published_catalogue(catalogue):
    k = star(catalogue, SIRIUS)
    assert np.degrees(catalogue.ra_rad[k]) == pytest.approx(101.28854105, abs=1e-6)
    assert np.degrees(catalogue.dec_rad[k]) == pytest.approx(-16.71314306, abs=1e-6)
    assert catalogue.parallax_rad[k] / RAD_PER_MAS == pytest.approx(379.21, abs=0.01)
    assert catalogue.pm_ra_cosdec_rad_yr[k] / RAD_PER_MAS == pytest.approx(-546.01, abs=0.01)
    assert catalogue.pm_dec_rad_yr[k] / RAD_PER_MAS == pytest.approx(-1223.07, abs=0.01)
    assert catalogue.magnitude[k] == pytest.approx(-1.09, abs=0.01)


def test_solution_types_are_the_last_digit_and_mostly_single_stars(catalogue):
    assert set(np.unique(catalogue.solution_type)) <= {0, 1, 3, 5, 7, 9}
    assert 0.9 < np.mean(catalogue.solution_type == SINGLE_STAR) < 1.0


@pytest.mark.parametrize("hip", [XI_URSAE_MAJORIS, 0, -1, 999_999, 115125])
def test_numbers_that_are_not_there_answer_minus_one(deep_catalogue, hip):
    assert star(deep_catalogue, hip) == -1


@given(hip=st.lists(st.integers(-5, 130_000), max_size=50))
def test_index_of_finds_each_star_under_its_own_number(catalogue, hip):
    hip = np.array(hip, dtype=np.int64)
    index = catalogue.find_index(hip)
    assert (catalogue.hip[index[index >= 0]] == hip[index >= 0]).all()
    assert not np.isin(hip[index < 0], catalogue.hip).any()


def test_an_empty_catalogue_knows_no_star():
    none = load_catalogue(None, magnitude_limit=-5.0)
    assert len(none) == 0
    assert none.find_index(np.array([1, 2])).tolist() == [-1, -1]


def test_the_cache_holds_what_the_package_holds_and_nothing_half_written(tmp_path):
    folder = tmp_path / "catalogue"
    first, second = load_catalogue(folder, 6.0), load_catalogue(folder, 6.0)
    assert same(first, second)
    assert [path.suffix for path in folder.iterdir()] == [".npz"]


def test_the_second_reading_comes_from_the_cache(tmp_path, monkeypatch):
    load_catalogue(tmp_path, 6.0)
    monkeypatch.setattr("boresight.sky.catalogue._read_package", lambda _: pytest.fail("the package was read again"))
    assert len(load_catalogue(tmp_path, 6.0)) > 4000


def test_each_magnitude_has_its_own_cache(tmp_path):
    assert len(load_catalogue(tmp_path, 5.0)) < len(load_catalogue(tmp_path, 6.0))


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 half a file", b"\x93NUMPY"])
def test_a_damaged_cache_is_made_again(tmp_path, content):
    whole = load_catalogue(tmp_path, 6.0)
    cache = next(tmp_path.iterdir())
    cache.write_bytes(content)
    assert same(load_catalogue(tmp_path, 6.0), whole)
    assert cache.stat().st_size > 1000


def test_a_folder_that_cannot_be_made_means_no_cache(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_bytes(b"")
    assert len(load_catalogue(blocked / "catalogue", 6.0)) > 4000
