"""Distribution of episodes among simulators of different speed, compared with an exhaustive search."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rkhs_ros.rollouts.batch_sharing import ALIKE, FIRST_PATIENCE, EpisodeTiming, share

seconds = st.lists(st.sampled_from([1.0, 2.5, 6.0, 20.0]), min_size=1, max_size=3)


def longest(counts: list[int], known: list[float]) -> float:
    return max(count * each for count, each in zip(counts, known, strict=True))


@given(episodes=st.integers(1, 12), known=seconds)
def test_with_sufficient_capacity_the_shares_are_optimal(episodes: int, known: list[float]) -> None:
    counts = share(episodes, [episodes] * len(known), known)
    assert sum(counts) == episodes
    ways = [way for way in product(range(episodes + 1), repeat=len(known)) if sum(way) == episodes]
    assert longest(counts, known) == min(longest(list(way), known) for way in ways)


@given(episodes=st.integers(1, 12), known=seconds, data=st.data())
def test_shares_respect_capacities_and_leave_no_capacity_idle(
    episodes: int, known: list[float], data: st.DataObject
) -> None:
    capacities = data.draw(st.lists(st.integers(1, 4), min_size=len(known), max_size=len(known)))
    counts = share(episodes, capacities, known)
    assert 1 <= sum(counts) <= episodes
    assert all(count <= room for count, room in zip(counts, capacities, strict=True))


@pytest.mark.parametrize("known", [[0.0, 0.0, 0.0], [1.0, 0.0, ALIKE], [1.0, 1.2, 0.9]])
def test_simulators_of_similar_speed_get_equal_shares(known: list[float]) -> None:
    assert share(9, [9, 9, 9], known) == [3, 3, 3]


def test_a_slow_simulator_gets_fewer_episodes_or_none() -> None:
    assert share(10, [10, 10], [1.0, 4.0]) == [8, 2]
    assert share(10, [10, 10], [1.0, 11.0]) == [10, 0]
    assert share(10, [1, 1], [1.0, 2.5]) == [1, 0]


def test_the_time_of_an_unused_simulator_expires_after_doubling_intervals() -> None:
    each = EpisodeTiming()
    each.took(8.0, 4)
    assert each.seconds == 2.0
    forgotten = []
    for batch in range(100):
        each.left_out()
        if each.seconds == 0.0:
            forgotten.append(batch + 1)
            each.took(8.0, 4)
    assert forgotten == [FIRST_PATIENCE, 3 * FIRST_PATIENCE, 7 * FIRST_PATIENCE]
