"""``rkhs evaluate``: measure a policy in evaluation episodes."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rkhs_ros.app.domain import reserved_domain
from rkhs_ros.app.inline import load_acting
from rkhs_ros.app.launcher import launch, write_parameters
from rkhs_ros.app.named import add_environment_argument
from rkhs_ros.app.robots import check_robot, default_domain, robot_of
from rkhs_ros.base.endings import FAILED, RESUMABLE
from rkhs_ros.base.ros import require_ros
from rkhs_ros.base.validation import require
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.evaluation import Evaluation
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.report import last_policy

EPISODES, ROBOT_EPISODES = 100, 10  # defaults of --episodes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("policy", type=Path, metavar="DIR|FILE", help="a run's folder, or a policy file")
    parser.add_argument(
        "--episodes",
        type=int,
        metavar="N",
        help=f"number of episodes (default: {EPISODES}; {ROBOT_EPISODES} on a robot)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of all randomness (default: %(default)s)"
    )
    add_environment_argument(parser)
    parser.add_argument(
        "--discount", type=float, metavar="D", help="discount factor of the return (default: that of the task)"
    )


def run(options: argparse.Namespace) -> int:
    """Print the discounted and the undiscounted evaluation return as JSON."""
    episodes, discount = options.episodes, options.discount
    require(episodes is None or episodes >= 1, "--episodes", "at least 1", episodes)
    require(discount is None or 0.0 <= discount <= 1.0, "--discount", "a number in [0, 1]", discount)
    if (config := robot_of(options.policy)) is not None:
        return _on_robot(options, config)
    with load_acting(options.policy, options.env) as (policy, task, runner):
        collected = runner.collect(policy, Batch(options.seed, 0, episodes or EPISODES, task.horizon, explore=False))
    discount = task.discount if discount is None else discount
    evaluation = Evaluation.of(collected, task.environment, options.seed, discount)
    print(json.dumps(evaluation.statistics(), indent=2))
    return 0


def _on_robot(options: argparse.Namespace, config: Config) -> int:
    """Start the robot's nodes for evaluation episodes; the learner node prints the return."""
    require_ros("rkhs evaluate")
    folder = options.policy if options.policy.is_dir() else options.policy.parent
    policy = last_policy(folder) if options.policy.is_dir() else options.policy
    load_policy(policy)
    check_robot(config)
    discount = config.training.discount if options.discount is None else options.discount
    asked = {"evaluation_episodes": options.episodes or ROBOT_EPISODES, "seed": options.seed, "discount": discount}
    config = replace(config, training=replace(config.training, **asked))
    paths = {"evaluate": str(policy.resolve()), "output": str(folder.resolve())}
    with reserved_domain(folder, default_domain(config)), TemporaryDirectory() as place:
        code = launch(config, write_parameters(config, Path(place) / "parameters.yaml", **paths))
    return FAILED if code == RESUMABLE else code
