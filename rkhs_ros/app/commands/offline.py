"""``rkhs offline``: train a policy from recordings alone, with a dynamics model fitted to their episodes."""

import argparse
import sys
from contextlib import closing
from dataclasses import replace
from math import inf
from pathlib import Path

from rkhs_ros.app.inline import spaces_of
from rkhs_ros.app.named import SUFFIXES, named, source
from rkhs_ros.base.endings import Lossy
from rkhs_ros.base.files import locked
from rkhs_ros.base.validation import require
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.learning.training_settings import AUTO
from rkhs_ros.pictures.run_pictures import draw_run
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.policies.storage import save_policy
from rkhs_ros.policies.streams import Batch
from rkhs_ros.recordings.container import MessageFile
from rkhs_ros.recordings.recorder import Recorder
from rkhs_ros.recordings.recording import FILE, Recording, read_recording
from rkhs_ros.runs.config import Config, Environment, load_config
from rkhs_ros.runs.offline import all_episodes, learn_offline, offline_changes, offline_settings
from rkhs_ros.runs.progress import progress_bar
from rkhs_ros.runs.recorded import head_of_run
from rkhs_ros.runs.report import BEST_POLICY, Report, new_folder
from rkhs_ros.runs.run import finished

ITERATIONS = 3  # of model-based training


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add(
        "sources",
        type=source,
        nargs="+",
        metavar="RECORDING",
        help="recordings of one task, and optionally a configuration, *.yaml",
    )
    add("--seed", type=int, metavar="N", help="seed of all randomness")
    about = "number of times that the policy is trained in the model (default: %(default)s)"
    add("--iterations", type=int, default=ITERATIONS, metavar="N", help=about)
    about = "settings to replace, such as model.centres=300"
    add("--set", nargs="+", type=named, action="extend", default=[], metavar="KEY=VALUE", help=about)
    add("--out", type=Path, metavar="DIR", help="folder for the results (default: results/NAME/TIME)")
    add("--quiet", action="store_true", help="no progress bar")


def run(options: argparse.Namespace) -> int:
    """Train the policy, plot the run and print the returns."""
    files = [path for path in options.sources if path.suffix in SUFFIXES]
    require(len(files) <= 1, "offline", "at most one configuration", ", ".join(map(str, files)))
    recordings = {str(path): read_recording(path) for path in options.sources if path not in files}
    require(bool(recordings), "offline", "at least one recording", "none")
    episodes = all_episodes(recordings)
    changes = [f"iterations={options.iterations}", f"horizon={episodes.horizon}"]
    changes += [f"seed={options.seed}"] if options.seed is not None else []
    config, spaces = _settings(recordings, files[0] if files else None, [*changes, *options.set])
    if config.training.action_repeat == AUTO:
        repeats = [each.action_repeat for each in recordings.values() if each.action_repeat]
        config = replace(config, training=replace(config.training, action_repeat=repeats[0] if repeats else AUTO))
    folder = new_folder(options.out, config.training.name)
    print(_train_into(folder, config, spaces, episodes, quiet=options.quiet), file=Lossy(sys.stdout), flush=True)
    return 0


def _settings(recordings: dict[str, Recording], file: Path | None, changes: list[str]) -> tuple[Config, Spaces]:
    """Return the settings of a configuration, or those of the first recording if there is none."""
    name, recording = next(iter(recordings.items()))
    if recording.head is None:
        if file is None:
            what = "a recording with a damaged header" if recording.lost else "a bag"
            raise ValueError(f"{name}: expected a configuration as well, since {what} names no task, got none")
        config = _configured(file, changes)
        return config, spaces_of(config.environment)
    task = recording.head.task
    environment = Environment(task.environment, dict(task.options))
    if file is None:
        return Config(environment, offline_settings(recording.head, changes)), recording.head.spaces
    config = _configured(file, changes)
    known = (config.environment.id, dict(config.environment.options))
    expected = f"the environment of {name}"
    require(known == (task.environment, dict(task.options)), f"{file}: environment", expected, known)
    return config, recording.head.spaces


def _configured(file: Path, changes: list[str]) -> Config:
    return load_config(file, offline_changes(load_config(file).training, changes))


def _train_into(folder: Path, config: Config, spaces: Spaces, episodes: Episodes, *, quiet: bool) -> str:
    """Train, write the results of the run into its folder, and return a summary of a few lines."""
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
    draw_run(folder)
    recorded = f"{episodes.returns(config.training.discount).mean():.4g} in the recorded episodes"
    return (
        f"Trained on {config.environment.id} from {len(episodes)} recorded episodes, without running new ones.\n"
        f"Discounted return: {recorded}, {iteration.model_return:.4g} in the model, at best {best:.4g}.\n"
        f"Policy: {folder / 'policy.npz'}"
    )
