"""Executable ``learner`` of ``ros2 run`` and the launch file: the learner node, which plots its run at the end."""

from pathlib import Path


def draw(folder: Path) -> None:
    """Plot a run, as ``rkhs train`` does."""
    import rkhs_ros.app.inline  # noqa: F401  # registers the tasks; here, since the run needs neither tasks
    from rkhs_ros.pictures.run_pictures import draw_run  # nor pictures before its end

    draw_run(folder)


def main() -> None:
    """Run the learner node."""
    from rkhs_ros.nodes.lockstep.learner_node import main as run_node  # here, since the import needs ROS

    run_node(draw)


if __name__ == "__main__":
    main()
