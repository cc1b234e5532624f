"""Simulator and policy node in one process, which communicate over topics without a network."""

from rkhs_ros.base.endings import Stop
from rkhs_ros.nodes.core.spin import open_node, run, serve
from rkhs_ros.nodes.lockstep.policy_node import PolicyNode
from sim_nodes.simulator_node import SimulatorNode


def serve_with_policy(simulator: SimulatorNode, stop: Stop) -> None:
    """Serve a simulator and a policy node in one process until `stop` is set."""
    policy = PolicyNode("policy")
    try:
        open_node(policy)
        serve(simulator, stop, policy)
    finally:
        policy.destroy_node()


def main() -> None:
    """Run both nodes."""
    run(SimulatorNode, "simulator", serve_with_policy)


if __name__ == "__main__":
    main()
