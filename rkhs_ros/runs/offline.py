"""Offline training: the policy trains in a dynamics model of recorded episodes, without new episodes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import ceil
from typing import Any

from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.iteration import Iteration
from rkhs_ros.learning.model_based.real_experience import RealExperience
from rkhs_ros.learning.model_based.training_in_model import train_in_model
from rkhs_ros.learning.state import Known, State, first_state
from rkhs_ros.learning.training import with_action_repeat
from rkhs_ros.learning.training_settings import ModelBased, Training
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.recordings.recording import Recording

MODEL = "model={form: gaussian_process}"
HELD_OUT = 0.2  # share of the episodes that tests a model of the others


def learn_offline(training: Training, spaces: Spaces, episodes: Episodes) -> Iterator[Iteration]:
    """Train in a dynamics model of recorded episodes; yield each iteration, which has no evaluation.

    A model of most episodes is tested on the held-out ones. With ``action_repeat: auto``, the recorded episodes
    determine the action repeat.
    """
    settings, state = training.model, first_state(training, spaces)
    if not isinstance(settings, ModelBased):
        raise ValueError("model.form: expected gaussian_process for offline training, got none")
    returns = episodes.returns(training.discount)
    before = Known.at(state, training)
    policy = with_action_repeat(state, training, episodes)
    state = replace(state, policy=policy, explorer=policy)
    newest, repeat = ceil(HELD_OUT * len(episodes)), state.policy.action_repeat
    while state.iterations < training.iterations:
        # The model is the same in all iterations, and has already compared the earlier policies.
        experience = RealExperience(
            training, spaces, episodes, newest, repeat, state.iterations, (state.policy,), may_explore=False
        )
        trained = train_in_model(settings, state.policy, experience)
        policy = trained.policy
        state = State(state.iterations + 1, policy, policy, episodes, len(episodes), 0, episodes.count)
        yield Iteration(
            before=before,
            state=state,
            exploration=episodes,
            exploration_returns=returns,
            evaluation=episodes.take(slice(0)),
            evaluation_returns=returns[:0],
            metrics=trained.metrics,
            model_return=trained.model_return,
            model_error=trained.model_error,
        )
        before = Known.at(state, training)


def all_episodes(recordings: Mapping[str, Recording]) -> Episodes:
    """Return the completed episodes of all recordings.

    The names of the recordings are for error messages.

    Raises:
        ValueError: the recordings have different tasks, or contain no episodes.
    """
    found: Sequence[Episodes] = [recording.episodes() for recording in recordings.values()]
    first_name, first = next(iter(recordings.items()))
    for (name, recording), episodes in zip(recordings.items(), found, strict=True):
        expected, got = (_task(each, of) for each, of in ((first, found[0]), (recording, episodes)))
        require(expected == got, f"{name}: task", f"the task of {first_name}, {expected}", got)
    return Episodes.concatenate(found)


def _task(recording: Recording, episodes: Episodes) -> tuple[Any, ...]:
    task = recording.head.task
    return task.environment, dict(task.options), *episodes.observations.shape[1:], episodes.actions.shape[2]


def offline_changes(training: Training, changes: Iterable[str]) -> list[str]:
    """Return changes of settings, preceded by those that select model-based training and disable evaluation."""
    is_model_based = isinstance(training.model, ModelBased)
    return [*([] if is_model_based else [MODEL]), "evaluate_every=0", *changes]
