import csv
from collections.abc import Callable
from pathlib import Path

import pytest

from rkhs_ros.app.inline import runner_of
from rkhs_ros.base.settings import entries, unused
from rkhs_ros.learning.training import train
from rkhs_ros.runs.config import load_config
from rkhs_ros.studies.search_space import SPREAD, Dimension, search_space
from test.unit.conftest import Result, assert_refused

pytestmark = [pytest.mark.slow, pytest.mark.nightly]

CONFIG = Path(__file__).parents[3] / "config" / "toy_nac.yaml"
TINY = ("--set", "horizon=4", "iterations=4", "episodes_per_iteration=2", "evaluation_episodes=2")
QUICK = (*TINY, "--seeds", "0-1", "--jobs", 1, "--quiet")
SPOILT = {"exploration_sd": 0.05, "algorithm.ridge": 0.1, "algorithm.step.divergence": 0.002}  # each by a factor of 10
Run = Callable[..., Result]


# The space


def test_by_default_the_numbers_of_the_learner_are_searched_around_their_values() -> None:
    space = {each.name: each for each in search_space(load_config(CONFIG), [])}
    assert space["algorithm.ridge"] == Dimension("algorithm.ridge", 0.01 / SPREAD, 0.01 * SPREAD)
    assert space["algorithm.exploration_decay"] == Dimension("algorithm.exploration_decay", 0.0, 1.0)
    assert space["algorithm.ridge"].is_log
    assert not space["algorithm.exploration_decay"].is_log
    assert not {"seed", "horizon", "discount", "iterations", "algorithm.centres"} & set(space)


def test_the_search_space_of_every_configuration_contains_its_values() -> None:
    for path in CONFIG.parent.glob("*.yaml"):
        config = load_config(path)
        space = search_space(config, [])
        assert len(space) >= 4, path
        for each in space:
            value = config.settings[each.name]
            number = value[0] if isinstance(value, tuple) else value
            assert each.low <= number <= each.high, (path, each)


def test_named_settings_have_a_default_range_a_given_range_or_choices() -> None:
    named = ["algorithm.centres=5:50", "algorithm.critic", "algorithm.trace", "algorithm.ridge=0.01:0.05"]
    assert search_space(load_config(CONFIG), named) == (
        Dimension("algorithm.centres", 5, 50, is_whole=True),
        Dimension("algorithm.critic", choices=("step", "trajectory")),
        Dimension("algorithm.trace", 0.0, 1.0),
        Dimension("algorithm.ridge", 0.01, 0.05),
    )


def test_a_number_is_searched_only_from_a_number() -> None:
    named = ["action_repeat=1:8"]
    assert search_space(load_config(CONFIG), named) == (Dimension("action_repeat", 1, 8, is_whole=True),)
    auto = load_config(CONFIG, ["action_repeat=auto"])
    with pytest.raises(ValueError, match=r"^--over: action_repeat: expected choices, .*number.*, got the range 1:8"):
        search_space(auto, named)
    with pytest.raises(ValueError, match=r"^--over: action_repeat: expected a range"):
        search_space(auto, ["action_repeat"])


VARIANTS = [
    ("name: rkhs_nac",),
    ("name: rkhs_nac, critic: trajectory",),
    ("name: rkhs_nac, regression: pursuit", "kernel.form=rbf + polynomial"),
    ("name: rkhs_ac, critic: trajectory", "kernel.form=polynomial"),
    ("name: rkhs_npg",),
    ("name: rkhs_npg, baseline: value", "kernel.form=linear"),
    ("name: rkhs_power",),
    ("name: rkhs_power, variance: constant, weighting: returns",),
    ("name: rkhs_power, weighting: as_published",),
    ("name: power, solution: diagonal, grid_low: [-4], grid_high: [4]",),
    ("name: rkhs_nac", "model={form: gaussian_process, updates: 3, rollouts: 4}"),
]
LOOSE = ("exploration_decay: 0.3", "exploration_minimum: 0.1")  # otherwise the minimum has no effect
SMALL = ("horizon=5", "iterations=3", "episodes_per_iteration=4", "evaluation_episodes=2")


@pytest.mark.nightly
@pytest.mark.parametrize("variant", VARIANTS, ids=" ".join)
def test_searched_settings_change_the_result_and_unused_ones_do_not(variant: tuple[str, ...]) -> None:
    algorithm, *changes = variant
    given = [f"algorithm={{{', '.join((algorithm, *LOOSE))}}}", *SMALL, *changes]
    config = load_config(CONFIG, given)
    runner = runner_of(config.environment)

    def learnt(name: str, value: float) -> bytes:
        training = load_config(CONFIG, [*given, f"{name}={value}"]).training
        return b"".join(
            each.exploration_returns.tobytes() + each.evaluation.actions.tobytes() for each in train(training, runner)
        )

    space = {each.name: each for each in search_space(config, [])}
    for name, dimension in space.items():
        if not name.startswith(("model.centres", "algorithm.sparsification")):  # more than the number of points
            assert learnt(name, dimension.low) != learnt(name, dimension.high), name
    idle = set(unused(config.training))
    assert not idle & set(space)
    for entry in entries(config.training):
        if entry.name in idle and not isinstance(entry.value, str | tuple):
            few, more = (2, 3) if isinstance(entry.value, int) else (0.3, 0.9)
            assert learnt(entry.name, few) == learnt(entry.name, more), entry.name


# The search


def trials(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((folder / "trials.csv").open()))


@pytest.mark.slow
def test_an_interrupted_search_gives_the_same_trials(rkhs: Run, tmp_path: Path) -> None:
    optuna = pytest.importorskip("optuna")
    search = ("tune", CONFIG, *QUICK, "--over", "algorithm.ridge", "exploration_sd")
    assert rkhs(*search, "--trials", 6, "--out", "whole").code == 0
    assert rkhs(*search, "--trials", 3, "--out", "cut").code == 0
    storage = f"sqlite:///{tmp_path / 'cut' / 'study.db'}"
    (name,) = optuna.get_all_study_names(storage)
    study = optuna.load_study(study_name=name, storage=storage, sampler=optuna.samplers.TPESampler(seed=3))
    wide = optuna.distributions.FloatDistribution
    study.ask(
        {"algorithm.ridge": wide(0.01 / SPREAD, 0.3, log=True), "exploration_sd": wide(0.5 / SPREAD, 15.0, log=True)}
    )
    assert rkhs(*search, "--trials", 6, "--out", "cut").code == 0  # the last trial has no result: it was interrupted

    def made(folder: str) -> list[list[str]]:
        return [list(line.values())[1:] for line in trials(tmp_path / folder)]

    assert made("cut") == made("whole")
    best = max(float(line["return"]) for line in trials(tmp_path / "whole") if line["state"] == "complete")
    content = (tmp_path / "whole" / "best.yaml").read_text()
    assert f"median over the seeds 0, 1: {best:.5g}" in content
    found = load_config(tmp_path / "whole" / "best.yaml")
    (line,) = {tuple(each.values()) for each in trials(tmp_path / "whole") if each["return"] == str(best)}
    assert str(found.settings["algorithm.ridge"]) in line
    before = (tmp_path / "whole" / "study.db").stat().st_mtime_ns
    assert rkhs(*search, "--trials", 6, "--out", "whole").code == 0
    assert (tmp_path / "whole" / "study.db").stat().st_mtime_ns == before


@pytest.mark.slow
@pytest.mark.nightly
def test_several_workers_run_each_trial_once(rkhs: Run, tmp_path: Path) -> None:
    optuna = pytest.importorskip("optuna")
    search = (
        "tune",
        CONFIG,
        *TINY,
        "--seeds",
        "0-1",
        "--jobs",
        2,
        "--quiet",
        "--over",
        "algorithm.critic",
        "--out",
        "two",
    )
    for count in (2, 5):  # two settings, so that most trials repeat others
        assert rkhs(*search, "--trials", count).code == 0
        made = trials(tmp_path / "two")
        assert [line["state"] for line in made].count("fail") == 0
        assert [line["trial"] for line in made] == [str(number) for number in range(count)]
        assert made[0]["algorithm.critic"] == "step"  # the initial setting
    storage = f"sqlite:///{tmp_path / 'two' / 'study.db'}"
    (name,) = optuna.get_all_study_names(storage)
    found = optuna.load_study(study_name=name, storage=storage).trials
    assert all(len(each.intermediate_values) >= 1 and each.state.is_finished() for each in found)


@pytest.mark.slow
def test_failing_settings_do_not_stop_the_search(rkhs: Run, tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    result = rkhs(
        "tune", CONFIG, *QUICK, "--over", "kernel.degree=1:20", "model.form", "algorithm.step.rule", "--trials", 12
    )
    assert result.code == 0
    made = trials(tmp_path / "results" / "tuned" / "toy_nac")
    assert len(made) == 12
    assert {line["state"] for line in made} >= {"complete", "fail"}
    assert all(line["why"] for line in made if line["state"] == "fail")


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_tuning_repairs_a_spoilt_configuration(rkhs: Run, tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    spoilt = [f"{name}={value}" for name, value in SPOILT.items()]
    result = rkhs(
        "tune", CONFIG, "--set", *spoilt, "--trials", 60, "--seeds", 0, "--jobs", 1, "--quiet", "--out", "tuned"
    )
    assert result.code == 0
    states = [line["state"] for line in trials(tmp_path / "tuned")]
    assert states.count("pruned") >= 5
    best = load_config(tmp_path / "tuned" / "best.yaml").settings

    def learnt(*changes: str) -> float:
        assert (
            rkhs(
                "sweep", CONFIG, "--vary", "algorithm.ridge_norm=norm", "--seeds", "5-9", "--quiet", "--set", *changes
            ).code
            == 0
        )
        (line,) = csv.DictReader((tmp_path / "results" / "sweeps" / "toy_nac" / "medians.csv").open())
        return float(line["final_return"])

    found = [
        f"{name}={best[name] if not isinstance(best[name], tuple) else list(best[name])}"
        for name in trials(tmp_path / "tuned")[0]
        if "." in name or name in SPOILT
    ]
    ours, mended = learnt("iterations=40"), learnt(*found)  # other seeds than in the search
    assert learnt(*spoilt) < ours - 5.0
    assert mended > ours - 0.2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--over", "algorithm.rigde"), "unknown setting 'algorithm.rigde', did you mean 'algorithm.ridge'?"),
        (
            ("--over", "algorithm.ridge=1e-3:1e9"),
            "--over: algorithm.ridge: expected a number in [1e-12, 1000000.0], got",
        ),
        (
            ("--over", "algorithm.ridge=1:2"),
            "--over: algorithm.ridge: expected a range that includes the initial value",
        ),
        (("--over", "algorithm.ridge=1"), "--over: algorithm.ridge: expected a range LOW:HIGH, got '1'"),
        (("--over", "algorithm.centres=1.5:40"), "--over: algorithm.centres: expected whole numbers LOW < HIGH"),
        (("--over", "algorithm.critic=step,walk"), "--over: algorithm.critic: unknown choice 'walk'"),
        (("--over", "discount"), "--over: expected settings that do not change the task"),
        (("--over", "iterations"), "--over: expected settings of the learner, got iterations"),
        (
            ("--over", "algorithm.step.annealing"),
            "expected a range, such as algorithm.step.annealing=LOW:HIGH, got none for 0.0",
        ),
        (("--set", "evaluate_every=0"), "evaluate_every: expected 1 to 40"),
        (("--trials", "0"), "--trials: expected a number in [1, 100000], got 0"),
        (("--storage", "nowhere"), "--storage: expected"),
        (("--set", "seed=3"), "--set: expected each setting once, got seed in both --set and --seeds"),
        (("--out", CONFIG), f"--out: expected a folder, got the file {CONFIG}"),
    ],
)
def test_invalid_options_are_rejected_once_and_nothing_starts(
    rkhs: Run, tmp_path: Path, arguments: tuple[object, ...], message: str
) -> None:
    pytest.importorskip("optuna")
    assert_refused(rkhs("tune", CONFIG, "--trials", "3", *arguments), message)
    assert not list(tmp_path.rglob("curve.csv"))
