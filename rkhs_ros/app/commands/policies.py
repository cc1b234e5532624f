"""``rkhs evaluate``, ``rkhs render``, ``rkhs plot`` and ``rkhs export``: measure, show and export policies."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from rkhs_ros.app.inline import add_environment_argument, load_acting
from rkhs_ros.app.launcher import launch, reserved_domain, write_parameters
from rkhs_ros.app.measure import evaluate
from rkhs_ros.app.robots import check_robot, default_domain, robot_of
from rkhs_ros.base.endings import FAILED, RESUMABLE
from rkhs_ros.base.files import write_whole
from rkhs_ros.base.validation import require, require_extra, require_ros
from rkhs_ros.policies.onnx_export import TOLERANCE, export_onnx
from rkhs_ros.policies.policy import load
from rkhs_ros.policies.storage import load_policy
from rkhs_ros.recordings.lerobot import export
from rkhs_ros.recordings.recording import read_recording
from rkhs_ros.runs.config import Config
from rkhs_ros.runs.report import last_policy

EPISODES, ROBOT_EPISODES, FRAMES = 100, 10, 60  # defaults of --episodes and --frames
POLICY = "a run's folder, or a policy file"
FORMATS = (".onnx", ".html")


def add_evaluate(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs evaluate``."""
    add, about = parser.add_argument, f"number of episodes (default: {EPISODES}; {ROBOT_EPISODES} on a robot)"
    add("policy", type=Path, metavar="DIR|FILE", help=POLICY)
    add("--episodes", type=int, metavar="N", help=about)
    add("--seed", type=int, default=0, metavar="N", help="seed of all randomness (default: %(default)s)")
    add("--discount", type=float, metavar="D", help="discount factor of the return (default: that of the task)")
    add_environment_argument(parser)


def run_evaluate(options: argparse.Namespace) -> int:
    """Print the discounted and the undiscounted evaluation return as JSON."""
    if (config := robot_of(options.policy)) is not None:
        return _evaluate_on_robot(options, config)
    episodes = EPISODES if options.episodes is None else options.episodes
    how = {"episodes": episodes, "seed": options.seed, "discount": options.discount}
    print(json.dumps(evaluate(options.policy, options.env, **how).statistics(), indent=2))
    return 0


def _evaluate_on_robot(options: argparse.Namespace, config: Config) -> int:
    """Start the robot's nodes for evaluation episodes; the learner node prints the return."""
    require(options.env is None, "--env", "none for a policy of a robot", options.env)
    require_ros("rkhs evaluate")
    folder = options.policy if options.policy.is_dir() else options.policy.parent
    policy = last_policy(folder) if options.policy.is_dir() else options.policy
    load_policy(policy)
    check_robot(config)
    episodes = ROBOT_EPISODES if options.episodes is None else options.episodes
    discount = config.training.discount if options.discount is None else options.discount
    asked = {"evaluation_episodes": episodes, "seed": options.seed, "discount": discount}
    config = replace(config, training=replace(config.training, **asked))
    paths = {"evaluate": str(policy.resolve()), "output": str(folder.resolve())}
    with reserved_domain(folder, default_domain(config)), TemporaryDirectory() as place:
        code = launch(config, write_parameters(config, Path(place) / "parameters.yaml", **paths))
    return FAILED if code == RESUMABLE else code


def add_render(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs render``."""
    add = parser.add_argument
    add("policy", type=Path, metavar="DIR|FILE", help=POLICY)
    add("--out", type=Path, metavar="DIR", help="folder for film.png and film.gif (default: that of the policy)")
    add("--seed", type=int, default=0, metavar="N", help="seed of all randomness (default: %(default)s)")
    about = "maximum number of pictures (default: %(default)s)"
    add("--frames", type=int, default=FRAMES, metavar="N", help=about)
    add_environment_argument(parser)


def run_render(options: argparse.Namespace) -> int:
    """Write the film strip and the animation, and print their paths."""
    from rkhs_ros.pictures.film import animate, draw_strip, shoot  # here, since the import is slow

    path = options.policy
    remedy = f"one on a robot. Use rkhs evaluate {path} to run episodes, rkhs view {path} to show them"
    require(robot_of(path) is None, f"{path}", "a run in simulation", remedy)
    with load_acting(path, options.env) as acting:
        film = shoot(*acting, seed=options.seed, frames=options.frames)
    folder = options.out or (path if path.is_dir() else path.parent)
    folder.mkdir(parents=True, exist_ok=True)
    for write, name in ((draw_strip, "film.png"), (animate, "film.gif")):
        write(folder / name, film)
        print(folder / name)
    return 0


def add_plot(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs plot``."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="a run's folder")
    add_environment_argument(parser)


def run_plot(options: argparse.Namespace) -> int:
    """Draw curve.png and policy.png, and print their paths."""
    from rkhs_ros.pictures.run_pictures import draw_run  # here, since the import is slow

    for picture in draw_run(options.folder):
        print(picture)
    return 0


def add_export(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs export``."""
    add = parser.add_argument
    add("source", type=Path, metavar="DIR|FILE", help="a run's folder, a policy file, or a recording")
    about = "file for the policy, an ONNX graph (.onnx), or for a page of the run (.html)"
    add("file", type=Path, metavar="FILE", nargs="?", help=about)
    add("--lerobot", type=Path, metavar="DIR", help="new folder for the recorded episodes, as a LeRobotDataset v3.0")
    about = "steps per second, a whole number (default: from the time stamps of a robot)"
    add("--fps", type=int, metavar="N", help=about)
    add("--task", metavar="TEXT", help="description of the task (default: id of the environment)")
    add_environment_argument(parser)


def run_export(options: argparse.Namespace) -> int:
    """Write the policy, the page or the completed episodes."""
    source, file = options.source, options.file
    given = " and ".join(name for name in ("file", "lerobot") if getattr(options, name))
    require(given in ("file", "lerobot"), "export", "a file to write or --lerobot DIR", given or "neither")
    if options.lerobot:
        return _export_episodes(options)
    for name in ("fps", "task"):
        require(getattr(options, name) is None, f"--{name}", "none without --lerobot", getattr(options, name))
    require(file.suffix in FORMATS, f"{file}", f"a file that ends in {' or '.join(FORMATS)}", file.suffix or "none")
    if file.suffix == ".onnx":
        policy = load(last_policy(source) if source.is_dir() else source)
        file.parent.mkdir(parents=True, exist_ok=True)  # not for a policy that cannot be read
        count, error = export_onnx(policy, file)
        print(f"Exported the policy: {file}")
        print(f"Checked on {count} random observations: relative error {error:.1g} (limit {TOLERANCE:g})")
        return 0
    require_extra("viser", "view", "export")
    from rkhs_ros.view.recorded import Recorded
    from rkhs_ros.view.serving import html_page

    page = html_page(Recorded(source)).encode()
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, page)
    print(f"Exported the page of the run: {file}")
    return 0


def _export_episodes(options: argparse.Namespace) -> int:
    require(options.fps is None or options.fps >= 1, "--fps", "at least 1", options.fps)
    recording = read_recording(options.source)
    head = recording.head
    task = options.task or head.task.environment
    count, rate = export(list(recording.by_numbers().values()), task, options.lerobot, options.fps, head.spaces)
    print(f"Exported {count} episodes at {rate} steps per second: {options.lerobot}")
    return 0
