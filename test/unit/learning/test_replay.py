"""Replay recomputes a policy's actions from observations, bit-identically."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.replay import SAMPLES_AT_ONCE, check_actions
from rkhs_ros.policies.gaussian import Acting, GaussianPolicy
from rkhs_ros.policies.inputs import Inputs
from rkhs_ros.policies.streams import FILTERS, Batch
from rkhs_ros.policies.variance import ConstantVariance, FunctionVariance, KernelVariance
from rkhs_ros.rkhs.function import Function
from rkhs_ros.rkhs.kernels import RBF, Kernel, Polynomial

KERNELS: list[Kernel] = [
    RBF((1.3,)),
    Polynomial(0.5, 3),
    RBF((2.0,)) + Polynomial(0.0, 1),
    RBF((2.0,)) * Polynomial(1.0, 2),
]


def make_policy(rng: np.random.Generator, inputs: Inputs, d: int, n: int, noise: str = "white") -> GaussianPolicy:
    size, m = inputs.dimension(d, n), int(rng.choice([1, 2, 20]))
    kernel = KERNELS[rng.integers(4 if inputs.history == 1 else 1)]  # a polynomial of a long window overflows
    mean = Function(kernel, rng.normal(size=(m, size)), rng.normal(size=(m, n)))
    centres, low, high = rng.normal(size=(m, size)), np.full(n, 0.1), np.full(n, 3.0)
    variances = [
        ConstantVariance(rng.uniform(0.1, 2.0, n)),
        KernelVariance(RBF((1.0,)), centres, rng.uniform(0.1, 1.0, m), rng.uniform(0.1, 2.0, (m, n)), low, high),
        FunctionVariance(Function(kernel, centres, rng.normal(size=(m, n))), low, high),
    ]
    return GaussianPolicy(mean, variances[rng.integers(3)], inputs, noise)


def make_episodes(rng: np.random.Generator, policy: GaussianPolicy, batch: Batch, d: int) -> Episodes:
    """Run the policy step by step on random observations; episodes end at random."""
    shape = (batch.num_envs, batch.horizon)
    mask = np.arange(batch.horizon) < rng.integers(1, batch.horizon + 1, batch.num_envs)[:, None]
    observations = np.where(mask[:, :, None], rng.normal(size=(*shape, d)), 0.0)
    actions, latest = np.zeros((*shape, policy.mean.output_dim)), observations[:, 0]
    acting = Acting(policy, batch, explore=batch.explore)
    for t in range(batch.horizon):
        latest = np.where(mask[:, t, None], observations[:, t], latest)  # the last observation after the end
        actions[mask[:, t], t] = acting(t, latest)[mask[:, t]]
    return Episodes.without_ends(observations, actions, np.zeros(shape), mask)


@settings(max_examples=60)
@given(
    st.integers(0, 10**6),
    st.booleans(),
    st.sampled_from([1, 1, 2, 4]),
    st.sampled_from([0, 0, 2]),
    st.integers(0, 3),
    st.sampled_from(sorted(FILTERS)),
)
def test_the_actions_of_the_policy_that_acted_pass(
    seed: int, explore: bool, history: int, degree: int, angles: int, noise: str
) -> None:
    rng = np.random.default_rng(seed)
    d, n = int(rng.integers(3, 5)), int(rng.integers(1, 3))
    columns = tuple(float(column) for column in rng.permutation(d)[:angles])
    policy = make_policy(rng, Inputs(history, columns or "none", degree=degree), d, n, noise)
    batch = Batch(seed, 40, int(rng.integers(1, 9)), int(rng.integers(1, 20)), explore=explore)
    check_actions(make_episodes(rng, policy, batch, d), policy, batch)


@pytest.mark.parametrize("history", [1, 3])
@pytest.mark.parametrize(("explore", "noise"), [(True, "white"), (True, "pink"), (False, "white")])
def test_one_changed_bit_of_an_action_is_detected(history: int, explore: bool, noise: str) -> None:
    rng = np.random.default_rng(0)
    policy = make_policy(rng, Inputs(history), 3, 2, noise)
    batch = Batch(1, 40, 6, SAMPLES_AT_ONCE // 3, explore=explore)
    episodes = make_episodes(rng, policy, batch, 3)
    for row, step in ((0, 0), (5, int(episodes.mask[5].sum()) - 1), (3, 1)):
        actions = episodes.actions.copy()
        actions[row, step, 1] = np.nextafter(actions[row, step, 1], np.inf)
        place = rf"^environment {row} \(episode {batch.episodes[row]}\), step {step}"
        with pytest.raises(ValueError, match=rf"{place}: expected the policy's"):
            check_actions(replace(episodes, actions=actions), policy, batch)


@pytest.mark.parametrize("change", ["policy", "noise", "seed", "episodes", "kind"])
def test_the_actions_of_another_policy_or_batch_are_detected(change: str) -> None:
    rng = np.random.default_rng(1)
    policy, batch = make_policy(rng, Inputs(), 3, 2), Batch(1, 40, 6, 5, explore=True)
    episodes = make_episodes(rng, policy, batch, 3)
    if change == "policy":
        policy = policy.with_mean(policy.mean.scale(1 + 1e-12))
    elif change == "noise":
        policy = replace(policy, noise="pink")
    else:
        others = {"seed": {"seed": 2}, "episodes": {"first_episode": 41}, "kind": {"explore": False}}
        batch = replace(batch, **others[change])
    with pytest.raises(ValueError, match="expected the policy's action"):
        check_actions(episodes, policy, batch)
