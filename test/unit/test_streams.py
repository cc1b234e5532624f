import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rkhs_ros.policies.streams import Batch, stream, stream_seed

seeds, episodes = st.integers(0, 2**63), st.integers(0, 2**62)
names = st.text("abc/", min_size=1, max_size=8)


@given(seed=seeds, name=names, episode=episodes)
def test_a_stream_follows_from_seed_name_and_episode(seed: int, name: str, episode: int) -> None:
    first, second = (stream(seed, name, episode).standard_normal(5) for _ in range(2))
    assert np.array_equal(first, second)
    assert 0 <= stream_seed(seed, name, episode) < 2**63


def test_streams_differ_in_any_of_seed_name_and_episode() -> None:
    triples = [(s, n, e) for s in range(12) for n in ("a", "b", "1/a", "a/1") for e in range(12)]
    draws = {float(stream(*triple).standard_normal()) for triple in triples}
    assert len(draws) == len(triples)


def test_a_stream_takes_no_notice_of_what_was_drawn_before() -> None:
    expected = stream(1, "a", 2).standard_normal(4)
    stream(1, "a", 1).standard_normal(1000)
    assert np.array_equal(stream(1, "a", 2).standard_normal(4), expected)


@given(first=st.integers(0, 1000), rows=st.integers(1, 7), split=st.integers(1, 7), dim=st.integers(1, 3))
def test_the_draws_of_a_row_do_not_depend_on_the_split_of_the_rows(first: int, rows: int, split: int, dim: int) -> None:
    together = Batch(7, first, rows, 6, explore=True)
    starts = range(0, rows, split)
    parts = [Batch(7, first + start, min(split, rows - start), 6, explore=True) for start in starts]
    assert np.array_equal(np.concatenate([part.exploration(dim) for part in parts]), together.exploration(dim))
    assert [seed for part in parts for seed in part.environment_seeds()] == together.environment_seeds()


def test_a_longer_horizon_only_adds_draws() -> None:
    short, long = (Batch(0, 0, 3, horizon, explore=True).exploration(2) for horizon in (4, 9))
    assert np.array_equal(long[:, :4], short)


def test_training_and_evaluation_episodes_of_one_number_differ() -> None:
    training, evaluation = (Batch(0, 5, 1, 10, explore=explore) for explore in (True, False))
    assert training.environment_seeds() != evaluation.environment_seeds()
    assert not np.any(training.exploration(1) == evaluation.exploration(1))


@given(rows=st.integers(1, 20), parts=st.integers(1, 30), explore=st.booleans())
def test_the_parts_of_a_batch_are_its_episodes(rows: int, parts: int, explore: bool) -> None:
    batch = Batch(3, 11, rows, 4, explore=explore)
    split = batch.split(parts)
    assert len(split) == min(rows, parts)
    assert max(part.rows for part in split) - min(part.rows for part in split) <= 1
    assert [seed for part in split for seed in part.environment_seeds()] == batch.environment_seeds()
    assert np.array_equal(np.concatenate([part.exploration(2) for part in split]), batch.exploration(2))


def test_exploration_is_standard_normal() -> None:
    draws = Batch(0, 0, 100, 100, explore=True).exploration(2).ravel()  # 20000 draws
    # Standard errors: 0.007 of the mean, 0.01 of the variance; the margins are four of them.
    assert abs(draws.mean()) < 0.028
    assert draws.var() == pytest.approx(1.0, abs=0.04)
    assert abs(np.corrcoef(draws[:-1], draws[1:])[0, 1]) < 0.028


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": -1}, "seed: expected"),
        ({"seed": 2**64}, "seed: expected"),
        ({"first_episode": -1}, "first_episode: expected"),
        ({"rows": 0}, "rows: expected 1 to 10000 episodes, got 0"),
        ({"rows": 10_001}, "rows: expected"),
        ({"horizon": 0}, "horizon: expected"),
    ],
)
def test_a_batch_with_a_number_out_of_range_is_refused(change: dict[str, int], message: str) -> None:
    good = {"seed": 0, "first_episode": 0, "rows": 1, "horizon": 1, "explore": True}
    Batch(**good)
    with pytest.raises(ValueError, match=message):
        Batch(**{**good, **change})
