"""The ledger of a map's pieces: whatever is lost, overdue or computed twice, each result stands in its place once."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boresight.workers.cluster_executor import GROUP_S, FailedPiece, Pieces


@given(
    count=st.integers(1, 60),
    seconds=st.sampled_from([None, 1e-4, 0.01, 0.2, 3.0]),
    fates=st.lists(st.sampled_from(["done", "lost", "late"]), max_size=80),
)
def test_every_piece_has_its_result_once_whatever_becomes_of_the_groups(count, seconds, fates):
    pieces = Pieces(count, seconds)
    late = []
    for fate in [*fates, *["done"] * 4 * count]:
        group = pieces.take(2, returned=True)
        if not group:
            break
        if fate == "done":
            pieces.settle(group, [10 * place for place in group], 0.1)
        else:
            pieces.give_back(group)
            late.extend([group] if fate == "late" else [])
    for group in late:
        pieces.settle(group, [10 * place for place in group], 0.1)
    assert pieces.complete
    assert pieces.results() == [10 * place for place in range(count)]


def test_a_group_lasts_half_a_second_and_the_last_ones_less():
    pieces = Pieces(1000, seconds=0.01)
    sizes = []
    while group := pieces.take(2):
        sizes.append(len(group))
    assert sum(sizes) == 1000
    assert sizes[0] == GROUP_S / 0.01
    assert max(sizes) == sizes[0]
    assert sizes[-1] < sizes[0] / 5


@pytest.mark.parametrize("takers", [1, 2, 3])
def test_nobody_takes_more_than_a_share_of_half_of_what_is_left(takers):
    assert len(Pieces(100, seconds=0.004).take(takers)) == math.ceil(100 / (2 * takers))


def test_the_first_group_of_something_never_timed_is_one_piece():
    assert Pieces(100).take(1) == (0,)


def test_a_piece_that_was_lost_goes_only_to_who_asks_for_such():
    pieces = Pieces(1)
    pieces.give_back(pieces.take(1))
    assert pieces.take(1) == ()
    assert pieces.take(1, returned=True) == (0,)


def test_what_the_first_broken_piece_raised_is_raised_though_a_later_one_broke_before():
    pieces = Pieces(4)
    groups = [pieces.take(1) for _ in range(4)]
    pieces.settle(groups[2], [FailedPiece(KeyError("later"))], 0.1)
    assert not pieces.complete
    pieces.settle(groups[1], [FailedPiece(ValueError("first"))], 0.1)
    pieces.settle(groups[0], [1], 0.1)
    assert pieces.complete
    with pytest.raises(ValueError, match="first"):
        pieces.results()


def test_nothing_behind_a_broken_piece_is_given_out():
    pieces = Pieces(50)
    first, second = pieces.take(1), pieces.take(1)
    pieces.settle(second, [FailedPiece(ValueError())], 0.1)
    assert pieces.take(1) == ()
    pieces.give_back(first)
    assert pieces.take(1, returned=True) == first


def test_nothing_is_given_out_when_all_is_over():
    pieces = Pieces(50)
    pieces.close()
    assert pieces.take(1, returned=True) == ()
