"""The learner node: learns from episodes received over topics, and sends each policy to the policy node."""

import json
from array import array
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from rclpy.duration import Duration

from rkhs_interfaces.msg import LearningProgress
from rkhs_ros.base.endings import Stop, StoppedError
from rkhs_ros.base.settings import Entry, build, entries
from rkhs_ros.learning.iteration import Row
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.nodes.core.diagnostics import Diagnostics
from rkhs_ros.nodes.core.messages import LATCHED_QOS
from rkhs_ros.nodes.core.parameters import declare, declared, given
from rkhs_ros.nodes.core.peers import Peers
from rkhs_ros.nodes.core.spin import ReportingNode, run
from rkhs_ros.nodes.lockstep.simulator_link import ROBOT, SIMULATOR
from rkhs_ros.nodes.lockstep.topic_runner import TopicRunner
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.rollouts.evaluation import Evaluation
from rkhs_ros.runs.config import Config, Environment, environment_from
from rkhs_ros.runs.curve import BEGINNING, Curve, seconds_left
from rkhs_ros.runs.episode_files import save_episodes
from rkhs_ros.runs.report import interruption_summary, is_started, new_folder, next_steps, old_folder
from rkhs_ros.runs.run import run_training

Draw = Callable[[Path], object]
EVALUATION = "evaluation.npz"  # in the output folder: evaluation episodes of a policy
MOST_RECENT = 256  # iterations in a message of the progress
LAST_MESSAGE_TIMEOUT_S = 0.5  # for subscribers to receive the last message before the node exits


class LearnerNode(ReportingNode):
    """Runs the training loop over topics.

    Owns the settings of the run. Its runner collects the episodes; the run folder holds the results.
    """

    def open(self) -> None:
        """Declare the parameters and open topics and services."""
        tree = given(self, needs_section=True)
        self.output = declared(self, tree, "output", "", "folder for the results; empty for results/NAME/TIME")
        self.quiet = declared(self, tree, "quiet", False, "no progress bar")
        self.resume = declared(self, tree, "resume", False, "resume the run in the output folder, if there is one")
        about = "log each iteration for TensorBoard, in the output folder"
        self.tensorboard = declared(self, tree, "tensorboard", False, about)
        about = "policy.npz to evaluate instead of learning; empty to learn"
        self.evaluate = declared(self, tree, "evaluate", "", about)
        self.environment: Environment | None = None  # any one
        if "environment" in tree:
            self.environment = environment_from(tree.pop("environment"))
            about = "Gymnasium id of the environment; simulators of other environments are refused"
            declare(self, [Entry("environment.id", self.environment.id, {"description": about})])
        self.training = build(Training, tree)
        declare(self, entries(self.training))
        self.diagnostics = Diagnostics(self, lambda: self.runner.report())
        self.peers = Peers(self, self.training.timeout)
        kind = ROBOT if self.environment and self.environment.nodes else SIMULATOR
        self.runner = TopicRunner(self, self.peers, self.training.num_envs, kind)
        self._progress = self.create_publisher(LearningProgress, "progress", LATCHED_QOS)

    def heartbeat(self) -> float:
        """Publish the status and heartbeats that are due; return the seconds until the next ones."""
        return min(self.diagnostics.heartbeat(), self.runner.heartbeat())

    def publish_progress(self, folder: Path, rows: Sequence[Row]) -> None:
        """Publish the learning curve so far of a run; late subscribers receive the newest message."""
        iterations, recent = self.training.iterations, rows[-MOST_RECENT:]
        message = LearningProgress(
            stamp=self.get_clock().now().to_msg(),
            run=self.training.name,
            folder=str(folder.resolve()),
            iterations=iterations,
            **(rows[-1] if rows else BEGINNING)._asdict(),
            seconds_left=seconds_left(rows, iterations),
            last_iterations=array("I", [row.iteration for row in recent]),
            last_exploration_returns=array("d", [row.exploration_return for row in recent]),
            last_evaluation_returns=array("d", [row.evaluation_return for row in recent]),
            last_model_returns=array("d", [row.model_return for row in recent]),
        )
        self._progress.publish(message)

    def close(self) -> None:
        """Wait until subscribers have received the progress."""
        self._progress.wait_for_all_acked(Duration(seconds=LAST_MESSAGE_TIMEOUT_S))


def learn(node: LearnerNode, stop: Stop, draw: Draw) -> None:
    """Run the training of a learner node, until it is complete or `stop` is set."""
    node.peers.stop = stop
    with node.diagnostics.errors_reported():
        config = Config(node.runner.connect(node.environment), node.training)
        folder = Path(node.output).expanduser() if node.output else None
        resume = node.resume and folder is not None and is_started(folder)
        folder = old_folder(folder) if resume else new_folder(folder, config.training.name)
        node.get_logger().info(f"learning {config.environment.id}; the results are in {folder.resolve()}")
        rows: Sequence[Row] = []
        with suppress(ValueError):  # from a damaged curve, which the run writes again
            rows = Curve(folder / "curve.csv").rows()
        node.publish_progress(folder, rows)
        try:
            with stop.interrupting():  # training in a model takes seconds
                run_training(
                    config,
                    node.runner,
                    folder,
                    quiet=node.quiet,
                    resume=resume,
                    tensorboard=node.tensorboard,
                    is_robot=node.runner.is_robot,
                    on_iteration=lambda _, rows: node.publish_progress(folder, rows),
                    on_advice=lambda advice: node.get_logger().warning(advice),
                )
        except (StoppedError, KeyboardInterrupt):
            node.get_logger().info(interruption_summary(folder, config))
            if (folder / "policy.npz").is_file():
                draw(folder)
            raise
        finally:
            node.close()
        draw(folder)
        node.get_logger().info(next_steps(folder, config))


def measure(node: LearnerNode, stop: Stop) -> None:
    """Run evaluation episodes of a policy, print their returns, and save them in the output folder."""
    node.peers.stop = stop
    with node.diagnostics.errors_reported():
        policy, task = load_policy(Path(node.evaluate))
        environment, training = node.runner.connect(node.environment), node.training
        batch = Batch(training.seed, 0, training.evaluation_episodes, training.horizon, explore=False)
        episodes = node.runner.collect(policy, batch)
        save_episodes(Path(node.output) / EVALUATION, episodes, task)
        evaluation = Evaluation.of(episodes, environment.id, training.seed, training.discount)
        print(json.dumps(evaluation.statistics(), indent=2))


def main(draw: Draw = lambda folder: None) -> None:
    """Run the learner node: learn, or evaluate a policy; `draw` draws the figures, unless `rkhs train` does that."""

    def work(node: LearnerNode, stop: Stop) -> None:
        if node.evaluate:
            measure(node, stop)
        else:
            learn(node, stop, draw)

    run(LearnerNode, "learner", work)


if __name__ == "__main__":
    main()
