"""``rkhs tune-node``: tune the parameters of a ROS 2 node in a few dozen trials."""

import argparse
import signal
import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rkhs_ros.app.library import Result, train
from rkhs_ros.base.validation import require_ros
from rkhs_ros.base.yaml_text import loaded
from rkhs_ros.learning.training_settings import ModelBased
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.posterior import Posterior
from rkhs_ros.robot.tuning import Tuning, tuning_from

if TYPE_CHECKING:
    from rkhs_ros.nodes.robot.parameter_env import ParameterEnv

TRIALS = 5  # per iteration
EXPLORATION_SD = 0.4  # of a place in its range, from -1 to 1
CENTRES = 200
NEAR, FEWEST_PAIRS = 0.1, 5  # distance of two trials whose rewards differ by noise, and how many such pairs show it
CONFIRMED = 3  # best trials that are repeated at the end
BEST = "parameters.yaml"


def add_tune_node(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs tune-node``."""
    add = parser.add_argument
    add("file", type=Path, metavar="FILE", help="YAML file of the tuning; see docs/tune_node.md")
    add("--trials", type=int, metavar="N", help="maximum number of trials instead of that of the file")
    add("--seed", type=int, default=0, metavar="N", help="seed of all randomness (default: %(default)s)")
    add("--out", type=Path, metavar="DIR", help="folder of the run (default: results/FILE); an unfinished run resumes")
    add("--apply", action="store_true", help="leave the best parameters set at the end")
    parser.set_defaults(run=_tune_node)


def _tune_node(options: argparse.Namespace) -> int:
    """Run the trials; print the best parameters, and write them to a file for ``ros2 param load``."""
    require_ros("rkhs tune-node")
    tree = loaded(options.file.read_text())
    tuning = tuning_from(tree | ({"trials": options.trials} if options.trials else {}))
    folder = options.out or Path("results", options.file.stem)
    from rkhs_ros.nodes.robot.parameter_env import ParameterEnv, write_parameters  # here, since the import needs ROS

    for number in (signal.SIGHUP, signal.SIGQUIT):  # like Ctrl-C: the parameters are set again
        signal.signal(number, lambda number, frame: signal.raise_signal(signal.SIGINT))
    with closing(ParameterEnv(tuning, folder)) as environment:
        result = train(
            environment,
            name=options.file.stem,
            model=ModelBased(discovery="none"),
            iterations=max(1, (tuning.trials - (0 if tuning.context else CONFIRMED)) // TRIALS),
            episodes_per_iteration=TRIALS,
            seed=options.seed,
            horizon=1,
            action_repeat=1,
            evaluate_every=0,
            exploration_sd=[EXPLORATION_SD] * len(tuning.parameters),
            out=folder / "run",
            resume=True,
            callback=_goes_on,
        )
        values = _best(environment, tuning, result)
        write_parameters(folder / BEST, environment.name, values)
        for name, value in values.items():
            print(f"{name}: {value:.6g} (before: {environment.before[name]:.6g})")
        print(f"ros2 param load {environment.name} {folder / BEST}")
        if options.apply:
            environment.keep(values)
            print("The node keeps these parameters.", file=sys.stderr)
    return 0


def _trials(result: Result) -> tuple[Array, Array, Array]:
    """Return the contexts, actions and rewards of all trials, one row each."""
    episodes = result.iteration.state.memory
    return episodes.observations[:, 0], np.clip(episodes.actions[:, 0], -1.0, 1.0), episodes.rewards[:, 0]


def _goes_on(result: Result) -> bool:
    """Return False once the model expects less gain than the noise of trials that nearly repeat each other."""
    contexts, actions, rewards = _trials(result)
    distances = np.linalg.norm(actions[:, None] - actions, axis=2) + np.linalg.norm(
        contexts[:, None] - contexts, axis=2
    )
    pairs = np.argwhere(np.triu(distances < NEAR, k=1))
    if len(pairs) < FEWEST_PAIRS:
        return True
    noise = np.median(np.abs(rewards[pairs[:, 0]] - rewards[pairs[:, 1]]))
    points = np.concatenate([contexts, actions], axis=1)
    best = Posterior.fit(points, rewards[:, None], CENTRES).mean(points).max()
    return bool(result.iteration.model_return - best > noise)


def _best(environment: "ParameterEnv", tuning: Tuning, result: Result) -> dict[str, Any]:
    """Repeat the best trials, and return the best parameters; with a context, those of the policy for it."""
    if tuning.context:
        return environment.values(result.policy(environment.reset()[0]))
    _, actions, rewards = _trials(result)
    scores = {}
    for row in np.argsort(-rewards, kind="stable")[:CONFIRMED]:
        environment.reset()
        scores[row] = rewards[row] + environment.step(actions[row])[1]
    return environment.values(actions[max(scores, key=lambda row: float(scores[row]))])
