"""``rkhs imitate``, ``rkhs offline`` and ``rkhs replay``: learn from recorded episodes, and check a recording."""

import argparse
from contextlib import closing
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np

from rkhs_ros.app.inline import add_settings_argument, spaces_of
from rkhs_ros.base.endings import FAILED
from rkhs_ros.base.files import locked
from rkhs_ros.base.settings import build
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.imitation import Imitation
from rkhs_ros.learning.training_settings import AUTO
from rkhs_ros.policies.policy import Policy
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import Task, save_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.container import MessageFile
from rkhs_ros.recordings.recorder import Recorder
from rkhs_ros.recordings.recording import FILE, Recording, read_recording, recording_file
from rkhs_ros.runs.config import Config, Environment, config_of, load_config, tree_of
from rkhs_ros.runs.curve import Curve
from rkhs_ros.runs.episode_files import load_episodes
from rkhs_ros.runs.offline import all_episodes, learn_offline, offline_changes
from rkhs_ros.runs.progress import progress_bar
from rkhs_ros.runs.recorded import head_of_run
from rkhs_ros.runs.replay import DifferenceError, replay
from rkhs_ros.runs.report import BEST_POLICY, Report, is_started, new_folder, provenance_lines
from rkhs_ros.runs.run import finished

DISCOUNT = 0.99  # of imitated episodes, if the file contains no task
ITERATIONS = 3  # of model-based training from recordings


def add_imitate(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs imitate``."""
    add = parser.add_argument
    add("episodes", type=Path, metavar="DIR|EPISODES", help="a run's folder, episodes *.npz, or a recording")
    about = "the environment of the episodes, if the file does not name it, or its module is in the current folder"
    add("--env", metavar="ID", help=about)
    add_settings_argument(parser, "centres=300; also ridge, action_repeat, inputs.* and kernel.*")
    file = Path("imitated.npz")
    add("--out", type=Path, default=file, metavar="FILE", help="policy file to write (default: %(default)s)")


def run_imitate(options: argparse.Namespace) -> int:
    """Fit the policy, save it, and print its distance from the demonstrations."""
    file = options.episodes
    episodes, task, repeat = (*load_episodes(file), 1) if file.suffix == ".npz" else _demonstrations(file)
    imitation = build(Imitation, tree_of([f"action_repeat={repeat}", *options.set]))
    if task is None or options.env not in (None, task.environment):
        task = Task(options.env or "", {}, episodes.horizon, DISCOUNT)
    sizes = episodes.observations.shape[2], episodes.actions.shape[2]
    spaces = Spaces.unbounded(*sizes)
    if task.environment:
        spaces = spaces_of(Environment(task.environment, task.options))
    known = spaces.observation_dim, spaces.action_dim
    for what, got, size in zip(("observations", "actions"), sizes, known, strict=True):
        require(got == size, f"{file}: {what}", f"{size} numbers for {task.environment}", got)
    policy = Policy(imitation.fit(episodes, spaces), task, spaces)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    policy.save(options.out)
    mean = policy.gaussian.mean
    rms = " ".join(f"{sd:.3g}" for sd in np.sqrt(policy.gaussian.variance(np.zeros((1, mean.input_dim)))[0]))
    steps, centres = episodes.count, len(mean.centres)
    print(f"Fitted {centres} centres to {len(episodes)} episodes with {steps} steps; rms error of the action: {rms}.")
    print(f"Policy: {options.out}")
    if not task.environment:
        print("The policy file names no environment; pass --env ID to evaluate the policy.")
    return 0


def _demonstrations(path: Path) -> tuple[Episodes, Task, int]:
    """Return the episodes of a recording, or the last ones of a run, with their task and the action repeat, or 1."""
    recording = read_recording(path)
    episodes = recording.last_episodes() if is_started(path) else recording.episodes()
    return episodes, recording.head.task, recording.action_repeat or 1


def add_offline(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs offline``."""
    add = parser.add_argument
    about = "recordings of one task, and optionally a configuration, *.yaml"
    add("sources", type=Path, nargs="+", metavar="RECORDING", help=about)
    add("--seed", type=int, metavar="N", help="seed of all randomness")
    about = "number of times that the policy is trained in the model (default: %(default)s)"
    add("--iterations", type=int, default=ITERATIONS, metavar="N", help=about)
    add_settings_argument(parser, "model.centres=300")
    add("--out", type=Path, metavar="DIR", help="folder for the results (default: results/NAME/TIME)")
    add("--quiet", action="store_true", help="no progress bar")


def run_offline(options: argparse.Namespace) -> int:
    """Train the policy, plot the run and print the returns."""
    from rkhs_ros.pictures.run_pictures import draw_run  # here, since the import is slow

    files = [path for path in options.sources if path.suffix in (".yaml", ".yml")]
    require(len(files) <= 1, "offline", "at most one configuration", ", ".join(map(str, files)))
    paths = [path for path in options.sources if path not in files]
    require(bool(paths), "offline", "at least one recording", "none")
    different = {recording_file(path).resolve() for path in paths}
    require(len(different) == len(paths), "offline", "each recording once", ", ".join(map(str, paths)))
    recordings = {str(path): read_recording(path) for path in paths}
    episodes = all_episodes(recordings)
    changes = [f"iterations={options.iterations}", f"horizon={episodes.horizon}"]
    changes += [f"seed={options.seed}"] if options.seed is not None else []
    config, spaces = _settings(recordings, files[0] if files else None, [*changes, *options.set])
    if config.training.action_repeat == AUTO:
        repeats = [each.action_repeat for each in recordings.values() if each.action_repeat]
        config = replace(config, training=replace(config.training, action_repeat=repeats[0] if repeats else AUTO))
    folder = new_folder(options.out, config.training.name)
    last, best = _train_into(folder, config, spaces, episodes, quiet=options.quiet)
    draw_run(folder)
    recorded = f"{episodes.returns(config.training.discount).mean():.4g} in the recorded episodes"
    print(
        f"Trained on {config.environment.id} from {len(episodes)} recorded episodes, without running new ones.\n"
        f"Discounted return: {recorded}, {last:.4g} in the model, at best {best:.4g}.\n"
        f"Policy: {folder / 'policy.npz'}"
    )
    return 0


def _settings(recordings: dict[str, Recording], file: Path | None, changes: list[str]) -> tuple[Config, Spaces]:
    """Return the settings of a configuration, or those of the first recording if there is none."""
    name, recording = next(iter(recordings.items()))
    task = recording.head.task
    recorded = task.environment, dict(task.options)
    if file is None:
        before = config_of(recording.head.configuration)
        after = config_of(recording.head.configuration, offline_changes(before.training, changes))
        require(after.environment == before.environment, "--set", "no settings of the environment", "some")
        return Config(Environment(*recorded), after.training), recording.head.spaces
    config = load_config(file, offline_changes(load_config(file).training, changes))
    known = config.environment.id, dict(config.environment.options)
    require(known == recorded, f"{file}: environment", f"the environment of {name}", known)
    return config, recording.head.spaces


def _train_into(
    folder: Path, config: Config, spaces: Spaces, episodes: Episodes, *, quiet: bool
) -> tuple[float, float]:
    """Train, and write the results of the run into its folder; return the last and the best return in the model."""
    best = -inf
    with locked(folder):
        report, recorder = Report(folder, config, spaces), Recorder(MessageFile(folder / FILE), Recording())
        with closing(recorder), finished(report), progress_bar(config.training, quiet=quiet) as show:
            recorder.begin(head_of_run(config, spaces, warm_start=False))
            batch = Batch(config.training.seed, 0, len(episodes), episodes.horizon, explore=True)
            recorder.ended(batch, episodes, [])  # of policy 0, which is none of this run
            for iteration in learn_offline(config.training, spaces, episodes):
                recorder.updated(iteration)
                report.add(iteration)
                show(iteration)
                if iteration.model_return > best:
                    best = iteration.model_return
                    save_policy(folder / BEST_POLICY, iteration.policy, config.task, spaces)
    return iteration.model_return, best


def add_replay(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``rkhs replay``."""
    about = "a recording, or the folder of a recorded run"
    parser.add_argument("recording", type=Path, metavar="RECORDING", help=about)
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run_replay(options: argparse.Namespace) -> int:
    """Print that all updates are bit-identical, or the first update that is not."""
    recording = read_recording(options.recording)
    total = len(recording.updates)
    done, curve = 0, options.recording / "curve.csv"
    try:
        with progress_bar(
            replace(config_of(recording.head.configuration).training, iterations=max(total, 1)), quiet=options.quiet
        ) as show:
            for iteration in replay(recording):
                done = iteration.number
                show(iteration)
    except DifferenceError as error:
        others = {version for head in recording.heads for version in head.versions} - set(provenance_lines())
        versions = f" (recorded with {', '.join(sorted(others))})" if others else ""
        print(f"{error}; the first {done} of {total} updates are bit-identical{versions}")
        return FAILED
    rows = len(Curve(curve).rows()) if curve.is_file() else 0
    if rows > total:
        print(f"the first {total} of {rows} updates are bit-identical; the recording lacks the others")
        return FAILED
    print(f"all {total} updates are bit-identical")
    return 0
