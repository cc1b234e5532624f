"""The learner node: collects episodes over topics, updates the policy and pushes it to the policy node."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial, reduce
from itertools import count
from operator import add
from pathlib import Path
from threading import Event
from typing import Any

from rclpy.experimental import EventsExecutor
from rclpy.node import Node

from rkhs_interfaces.srv import DescribeTask, SetPolicy
from rkhs_ros.base.settings import entries
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.training import training_from
from rkhs_ros.nodes.health import Health
from rkhs_ros.nodes.messages import set_policy_request
from rkhs_ros.nodes.names import namespaces
from rkhs_ros.nodes.parameters import declare, declared, given, restarts
from rkhs_ros.nodes.simulator_link import SimulatorLink
from rkhs_ros.nodes.spin import LOOK_UP, PeerError, StoppedError, run
from rkhs_ros.policies.gaussian import GaussianPolicy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.runs.config import Config, Environment
from rkhs_ros.runs.report import is_begun
from rkhs_ros.runs.run import run_training

STANDS = 2.0  # seconds that a node must keep to its refusal
LOOK_AGAIN = 0.5  # seconds without episodes after which the peers are looked after
ASK_AGAIN, LEAST_OFTEN = 0.5, 4.0  # seconds after which a request is sent anew, twice as many each time


class LearnerNode(Node):
    """Runs the training loop over topics; a `Runner` to that loop.

    Owns the settings of the run and the numbers of its batches and policies. Does not own the environment, the policy
    in service or the steps of a batch: it hears whole episodes, so that a step costs one message each way between
    simulator and policy node. It brings peers back that died: what one of them no longer knows begins again, and comes
    out the same to the last bit.
    """

    def __init__(self) -> None:
        """Declare the parameters and open topics and services.

        Raises:
            ValueError: an unknown parameter or a value that does not fit.
        """
        super().__init__("learner", automatically_declare_parameters_from_overrides=True)
        tree = given(self)
        self.output = declared(self, tree, "output", "", "folder for the results; empty for results/NAME/TIME")
        self.quiet = declared(self, tree, "quiet", False, "no progress bar")
        self.resume = declared(
            self, tree, "resume", False, "go on with the run in the output folder, if one began there"
        )
        again = restarts(self, tree)
        self.training = training_from(tree)
        declare(self, entries(self.training))
        self.told = Event()  # to end
        self._executor = EventsExecutor()
        self._executor.add_node(self)
        # No result depends on the numbers; no other learner, and not this one started again, uses the same ones.
        self._numbers = count(time.time_ns())
        self._version = 0
        self._served: GaussianPolicy | None = None
        self._policy_instance = 0
        self._clock_steps = 0
        self._progress_at = 0.0
        self._health = Health(self, again, self._report)
        places = namespaces(self.training.simulators)
        self._simulators = [SimulatorLink(self, place, self._health.refuse) for place in places]
        self._set_policy = self.create_client(SetPolicy, "set_policy")

    def connect(self) -> Config:
        """Wait for simulator and policy node, and return the whole configuration.

        Raises:
            PeerError: one of them does not appear in time.
        """
        for simulator in self._simulators:
            self._until(simulator.describe.service_is_ready, simulator.name)
        self._until(self._set_policy.service_is_ready, "policy")
        for simulator in self._simulators:
            simulator.know(self._connected(partial(self._describe, simulator), simulator.name))
        task, *others = [simulator.task for simulator in self._simulators]
        for simulator, other in zip(self._simulators[1:], others, strict=True):
            if (other.environment, other.options) != (task.environment, task.options):
                raise PeerError(f"expected all simulators of one task, got {other.environment} from {simulator.name}")
        self._clock_steps = max(simulator.task.clock for simulator in self._simulators)
        self.spaces = self._simulators[0].spaces
        return Config(Environment(task.environment, json.loads(task.options), task.rows_at_once), self.training)

    def collect(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch under the policy.

        Raises:
            PeerError: a node did not answer in time, or there was one of this name before.
            ValueError: a node refused the policy or the batch.
        """
        if policy is not self._served:
            self._version, self._served = next(self._numbers), policy
            self._push(policy)
        room = sum(simulator.task.room for simulator in self._simulators)
        return reduce(add, (self._together(policy, part) for part in batch.parts(room)))

    def _together(self, policy: GaussianPolicy, batch: Batch) -> Episodes:
        """Return the episodes of a batch that the simulators have room for."""
        for simulator in self._simulators:
            simulator.rest()
        parts = batch.split(len(self._simulators))
        self._begin(list(zip(self._simulators, parts, strict=False)))
        self._progress_at = time.monotonic()
        while not self._spin(lambda: not self._busy(), LOOK_AGAIN):
            self._repair(policy)
        heard = [simulator.heard for simulator in self._simulators if simulator.heard is not None]
        self._health.steps += batch.horizon
        return reduce(add, heard)

    def _busy(self) -> bool:
        return any(simulator.busy for simulator in self._simulators)

    def _begin(self, tasks: list[tuple[SimulatorLink, Batch]]) -> None:
        """Have simulators begin batches."""
        for simulator, batch in tasks:
            simulator.begin(batch, next(self._numbers), self._version, self._clock_steps)
            self._ask_for_episodes(simulator)
        self._clock_steps += max(batch.horizon for _, batch in tasks)

    def _ask_for_episodes(self, simulator: SimulatorLink) -> None:
        self._accepted(simulator.start, simulator.request, simulator.name)

    def _describe(self, simulator: SimulatorLink) -> DescribeTask.Response:
        rows = max(self.training.episodes_per_iteration, self.training.evaluation_episodes)
        return self._call(simulator.describe, DescribeTask.Request(rows=rows), simulator.name)

    def _repair(self, policy: GaussianPolicy) -> None:
        """Ask again for what may have been lost, and begin anew what a node that died no longer knows."""
        policy_is_new = self._push(policy)
        for simulator in self._simulators:
            if simulator.busy and simulator.batch is not None:
                self._look_after(simulator, simulator.batch, policy_is_new)
        if self._busy() and time.monotonic() > self._progress_at + self.training.timeout:
            raise self._silent("policy", "acted in no step")

    def _look_after(self, simulator: SimulatorLink, batch: Batch, policy_is_new: bool) -> None:
        task, now = self._describe(simulator), time.monotonic()
        moved = simulator.moved(task)
        if policy_is_new or simulator.lost(task):
            self.get_logger().info(f"the batch of the {simulator.name} node begins anew")
            self._begin([(simulator, batch)])
            self._progress_at = now
        elif moved:
            self._progress_at = now
        elif now > self._progress_at + self.training.timeout / 2:
            self._begin([(simulator, batch)])  # for reasons that are not known
        else:
            self._ask_for_episodes(simulator)

    def _push(self, policy: GaussianPolicy) -> bool:
        """Have the policy node serve the policy; return whether it is another process than before."""
        ask = partial(self._accepted, self._set_policy, set_policy_request(policy, self._version), "policy")
        response = self._connected(ask, "policy")
        before, self._policy_instance = self._policy_instance, response.instance
        return bool(before != response.instance)

    def _connected(self, ask: Callable[[], Any], name: str) -> Any:
        """Ask a node again and again until it is connected to its peers."""
        deadline = time.monotonic() + self.training.timeout
        while not (response := ask()).connected:
            if time.monotonic() > deadline:
                raise self._silent(name, "found no peers")
        return response

    def _accepted(self, client: Any, request: Any, name: str) -> Any:
        """Ask a node until it accepts. A refusal must stand: one may come from a second node that is about to end."""
        deadline = time.monotonic() + STANDS
        while not (response := self._call(client, request, name)).accepted:
            if time.monotonic() > deadline:
                raise ValueError(f"the {name} node refused: {response.message}")
            self._spin(lambda: False, LOOK_UP)
        return response

    def _call(self, client: Any, request: Any, name: str) -> Any:
        """Ask a node; ask again where the answer was lost, as may happen to peers that have just met."""
        deadline = time.monotonic() + self.training.timeout
        patience = ASK_AGAIN
        while time.monotonic() < deadline:
            future = client.call_async(request)
            if self._spin(future.done, min(patience, self.training.timeout)):
                return future.result()
            client.remove_pending_request(future)
            patience = min(2 * patience, LEAST_OFTEN)
        raise self._silent(name)

    def _until(self, condition: Callable[[], bool], name: str) -> None:
        if not self._spin(condition, self.training.timeout):
            raise self._silent(name)

    def _silent(self, name: str, how: str = "did not answer") -> PeerError:
        return PeerError(f"the {name} node {how} within {self.training.timeout:g} s")

    def _spin(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Handle messages until the condition holds or the time is over; return whether it holds."""
        deadline = time.monotonic() + seconds
        while not condition():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            wait = min(left, LOOK_UP, self._health.look())  # nor do new peers wake it
            self._executor.spin_once(timeout_sec=wait)
            if self.told.is_set():
                raise StoppedError
        return True

    def _report(self) -> dict[str, object]:
        steps = [str(simulator.step) for simulator in self._simulators]
        batches = [str(simulator.request.batch) for simulator in self._simulators]
        return {"serving version": self._version, "batch": " ".join(batches), "step": " ".join(steps)}


def learn(node: LearnerNode, told: Event) -> None:
    """Run the whole training of a learner node, or until told to end."""
    node.told = told
    config = node.connect()
    folder = Path(node.output) if node.output else None
    begun = folder is not None and is_begun(folder)
    run_training(config, node, folder, quiet=node.quiet, resume=node.resume and begun)


def main() -> None:
    """Run the learner node."""
    run(LearnerNode, learn)


if __name__ == "__main__":
    main()
