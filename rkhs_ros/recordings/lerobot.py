"""Export of recorded episodes to a LeRobotDataset v3.0: parquet files and metadata, without images."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rkhs_ros.base.validation import require
from rkhs_ros.policies.spaces import Spaces
from rkhs_ros.recordings.recording import RecordedBatch
from rkhs_ros.rkhs.kernels import Array

if TYPE_CHECKING:
    import pyarrow

DATA = "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
TASKS = "meta/tasks.parquet"
INFO = {  # that is the same for all exports; we always write a single file
    "codebase_version": "v3.0",
    "robot_type": None,
    "total_tasks": 1,
    "chunks_size": 1000,
    "data_files_size_in_mb": 100,
    "video_files_size_in_mb": 200,
    "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "video_path": None,
}
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
NANOSECONDS = 1e9
RATE_TOLERANCE = 0.005  # relative difference between the rate of the time stamps and a whole number
INDEX = "__index_level_0__"  # column that LeRobot uses to look up tasks
Columns = dict[str, np.ndarray]  # of an episode: values by name, shape (steps,) or (steps, width)


def export(
    batches: Sequence[RecordedBatch], task: str, folder: Path, fps: int | None, spaces: Spaces
) -> tuple[int, int]:
    """Write episodes into a new folder as a dataset; return the number of episodes and the steps per second.

    LeRobot stores the steps per second as an integer, and looks up frames at this spacing.

    Args:
        batches: completed episodes.
        task: description of the task.
        folder: folder to create.
        fps: steps per second, which replace the time stamps; None for the time stamps of a robot.
        spaces: spaces of the task, which may name its components.

    Raises:
        ValueError: pyarrow is not installed, the folder exists, there are no episodes, or the rate is not whole.
        OSError: a file cannot be written.
    """
    try:
        from pyarrow import parquet
    except ImportError as error:
        raise ValueError("pyarrow: expected an installed package, got none. Run pip install pyarrow") from error
    require(not folder.exists(), f"{folder}", "a new folder", "an existing path")
    require(bool(batches), "recording", "completed episodes", "none")
    rate = _rate(batches) if fps is None else fps
    episodes = list(_episodes(batches, fps))
    frames = {name: np.concatenate([each[name] for each in episodes]) for name in episodes[0]}
    files = {DATA: _table(frames), EPISODES: _table(_descriptions(episodes, task)), TASKS: _tasks(task)}
    for name, table in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(table, folder / name)
    named = {"observation.state": spaces.observation_names, "action": spaces.action_names}
    features = {
        name: {
            "dtype": column.dtype.name,
            "shape": list(column.shape[1:]) or [1],
            "names": list(named.get(name, ())) or None,
        }
        for name, column in frames.items()
    }
    sizes = {"total_episodes": len(episodes), "total_frames": len(frames["index"])}
    info = INFO | sizes | {"fps": rate, "splits": {"train": f"0:{len(episodes)}"}, "features": features}
    stats = {name: {key: value.tolist() for key, value in _stats(column).items()} for name, column in frames.items()}
    for name, content in (("info", info), ("stats", stats)):
        (folder / f"meta/{name}.json").write_text(json.dumps(content, indent=4))
    return len(episodes), rate


def _rate(batches: Sequence[RecordedBatch]) -> int:
    """Return the steps per second from the time stamps of a robot."""
    if not all(each.executions for each in batches):
        raise ValueError("--fps: expected the steps per second, which simulations do not record, got none")
    steps = [np.diff(execution.stamps) for each in batches for execution in each.executions]
    interval = float(np.median(np.concatenate(steps)))
    require(interval > 0, "recording: time stamps", "increasing time stamps", f"steps of {interval:g} ns")
    measured = NANOSECONDS / interval
    rate = round(measured)
    if abs(rate - measured) > RATE_TOLERANCE * measured:
        raise ValueError(
            "recording: expected a whole number of steps per second, which LeRobot requires, "
            f"got {measured:.4g} from the time stamps. Use --fps N to replace the time stamps."
        )
    return rate


def _episodes(batches: Sequence[RecordedBatch], fps: int | None) -> Iterator[Columns]:
    index = 0
    singles = [single for batch in batches for single in batch.single_episodes()]
    for number, single in enumerate(singles):
        episodes, mask = single.episodes, single.episodes.mask[0]
        steps = np.arange(int(mask.sum()))
        done = steps == len(steps) - 1
        columns = {
            "observation.state": episodes.observations[0, mask],
            "action": episodes.actions[0, mask],
            "next.reward": episodes.rewards[0, mask],
        }
        for execution in single.executions:
            columns["action.executed"] = execution.executed
        if fps is None:
            stamps = single.executions[0].stamps
            columns["timestamp"] = (stamps[: len(steps)] - stamps[0]) / NANOSECONDS
        else:
            columns["timestamp"] = steps / fps
        yield {
            **{name: values.astype(np.float32) for name, values in columns.items()},
            "next.done": done,
            "next.terminated": done & episodes.terminated[0],
            "frame_index": steps,
            "episode_index": np.full(len(steps), number),
            "index": index + steps,
            "task_index": np.zeros(len(steps), dtype=np.int64),
        }
        index += len(steps)


def _descriptions(episodes: Sequence[Columns], task: str) -> dict[str, Any]:
    lengths = np.array([len(each["timestamp"]) for each in episodes])
    ends = np.cumsum(lengths)
    none = np.zeros(len(episodes), dtype=np.int64)
    stats = [{n: _stats(column) for n, column in each.items()} for each in episodes]
    return {
        "episode_index": np.arange(len(episodes)),
        "tasks": [[task]] * len(episodes),
        "length": lengths,
        "data/chunk_index": none,
        "data/file_index": none,
        "dataset_from_index": ends - lengths,
        "dataset_to_index": ends,
        "meta/episodes/chunk_index": none,
        "meta/episodes/file_index": none,
        **{
            f"stats/{name}/{key}": [each[name][key].tolist() for each in stats]
            for name in stats[0]
            for key in stats[0][name]
        },
    }


def _stats(column: np.ndarray) -> Mapping[str, Array]:
    values = np.asarray(column, dtype=np.float64).reshape(len(column), -1)
    quantiles = np.quantile(values, list(QUANTILES.values()), axis=0)
    return {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
        "count": np.array([len(values)]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def _table(columns: Mapping[str, Any]) -> pyarrow.Table:
    import pyarrow

    return pyarrow.table({name: _arrow(values) for name, values in columns.items()})


def _arrow(values: Any) -> pyarrow.Array:
    """Return a column of numbers, or of lists of equal length if the array has several columns."""
    import pyarrow

    if not isinstance(values, np.ndarray) or values.ndim == 1:
        return pyarrow.array(values)
    if values.shape[1] == 1:
        return pyarrow.array(values[:, 0])
    return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(values.ravel()), values.shape[1])


def _tasks(task: str) -> pyarrow.Table:
    """Return the table of task numbers by name, with the metadata that pandas needs for its index."""
    names = ("name", "field_name", "pandas_type", "numpy_type", "metadata")
    values = ("task_index", "task_index", "int64", "int64", None), (None, INDEX, "unicode", "object", None)
    about = [dict(zip(names, each, strict=True)) for each in values]
    pandas = {"index_columns": [INDEX], "column_indexes": [], "columns": about, "pandas_version": "2.0.0"}
    table = _table({"task_index": np.zeros(1, dtype=np.int64), INDEX: [task]})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})
