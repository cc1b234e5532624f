"""An episode on a robot as a state machine: clock, deadlines, misses, and reasons to discard it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from rkhs_ros.base.endings import RunError
from rkhs_ros.policies.streams import Batch
from rkhs_ros.robot.episode import MISSED, NO_REPORT, SLACK, Reading, RobotEpisode, next_tick
from rkhs_ros.robot.gate_state import Flags
from rkhs_ros.robot.sensors import SensingError
from rkhs_ros.robot.task import End, Reward, RobotTask, robot_task_from

PERIOD, DEADLINE = 0.1, 0.05
BATCH = Batch(seed=3, first_episode=7, num_envs=1, horizon=5, explore=True)
TASK = robot_task_from(
    {
        "period": PERIOD,
        "sensors": {"position": {"topic": "position", "type": "std_msgs/msg/Float64", "fields": ["data"]}},
        "action": {"minimum": [-1.0], "maximum": [1.0], "scale": [2.0], "offset": [0.5]},
        "reward": {"function": "test.unit.robot.robot_rules:encoded"},
        "end": {"function": "test.unit.robot.robot_rules:high"},
    }
)


def sensed(value: float) -> Callable[[], Reading]:
    return lambda: Reading(np.array([value]), 0.0, round(1e9 * value))


def begun(task: RobotTask = TASK) -> RobotEpisode:
    episode = RobotEpisode(BATCH, task, stamp=0)
    episode.begin(sensed(0.0)())
    return episode


def play(
    episode: RobotEpisode, delays: list[float | None], reports: bool = True, lateness: list[float] | None = None
) -> list[tuple[float, float]]:
    """Play a started episode from time 0; return the time and value of each sent command.

    The delays are those of each action after its observation, s, None for never; the first one starts the clock. The
    gate executes half of each command.
    """
    sent: list[tuple[float, float]] = []
    observed_at = now = 0.0
    waiting = {step: delay for step, delay in enumerate(delays) if delay is not None}
    came = {0: 0.0}
    while not episode.over:
        arrivals = {step: came[step] + delay for step, delay in waiting.items() if step in came}
        step, arrival = min(arrivals.items(), key=lambda item: item[1], default=(-1, np.inf))
        late = [*(lateness or [0.0] * BATCH.horizon), 0.0][episode.step]
        due = episode.due + late if episode.due > observed_at + DEADLINE + 1e-9 else episode.due
        if arrival <= due:
            now = arrival
            del waiting[step]
            command = episode.act(step, np.array([0.1 * (step + 1)]), now)
            if command is not None:
                sent.append((now, float(command[0])))
                if reports:
                    episode.report(step, command / 2, 0)
        else:
            now = max(due, now) + 1e-9
            if episode.proceed(now, sensed(episode.step + 1.0)):
                observed_at = came[episode.step] = now
    return sent


def test_actions_in_time_are_sent_on_arrival_and_recorded() -> None:
    episode = begun()
    sent = play(episode, [0.01] * 5)
    np.testing.assert_allclose(
        [at for at, _ in sent], 0.01 + PERIOD * np.arange(5) + [0, 0.01, 0.01, 0.01, 0.01], atol=1e-6
    )
    commands = 0.5 + 2 * 0.1 * np.arange(1, 6)
    np.testing.assert_allclose([value for _, value in sent], commands)
    episodes, execution = episode.ended()
    np.testing.assert_allclose(episodes.actions[0, :, 0], 0.1 * np.arange(1, 6))
    np.testing.assert_allclose(execution.executed[:, 0], commands / 2)
    executed = (commands / 2 - 0.5) / 2
    np.testing.assert_allclose(episodes.rewards[0], 1e4 * np.arange(5) + 1e2 * executed + np.arange(1, 6))
    assert episodes.final_observations == [[5.0]]
    np.testing.assert_array_equal(execution.stamps, 1e9 * np.arange(6))
    assert not execution.flags.any()
    assert execution.discard_reason == ""


def test_a_refusal_counts_although_its_step_is_over() -> None:
    episode = begun()
    episode.act(0, np.array([0.1]), 0.0)
    assert episode.proceed(PERIOD + 1e-9, sensed(1.0))
    episode.report(0, np.array([0.2]), 0)  # too late to be what was executed
    assert episode.discard_reason == ""
    episode.report(0, np.array([0.2]), Flags.REFUSED)
    assert episode.discard_reason == "the gate refused the command of step 0"


def test_an_action_after_the_deadline_is_recorded_but_not_sent() -> None:
    episode = begun()
    sent = play(episode, [0.0, 0.06, 0.01, 0.14, 0.01])
    assert len(sent) == 3
    episodes, execution = episode.ended()
    assert execution.discard_reason == ""
    assert [bool(flags & MISSED) for flags in execution.flags] == [False, True, False, True, False]
    np.testing.assert_allclose(episodes.actions[0, :, 0], 0.1 * np.arange(1, 6))  # what was drawn
    executed = execution.executed[:, 0]
    assert (executed[1], executed[3]) == (executed[0], executed[2])  # what was held


def test_late_actions_count_if_the_deadline_is_the_period() -> None:
    episode = begun(replace(TASK, action_deadline=1.0))
    play(episode, [0.0, *[PERIOD + 0.004] * 4], lateness=[0.005] * 5)  # each arrives just before a late tick
    assert episode.misses == TASK.misses_allowed + 1
    assert "too late" in episode.discard_reason


def test_the_last_action_may_arrive_late() -> None:
    episode = begun()
    sent = play(episode, [0.0, 0.01, 0.01, 0.01, 0.4])
    assert (episode.discard_reason, len(sent)) == ("", 4)
    np.testing.assert_allclose(episode.ended()[0].actions[0, :, 0], 0.1 * np.arange(1, 6))
    never = begun()
    play(never, [0.0, 0.01, None, 0.01, 0.01])
    assert never.discard_reason == "the action of step 2 did not arrive"


@given(st.lists(st.floats(0.0, 0.3), min_size=1, max_size=50), st.floats(0.01, 1.0))
def test_no_step_is_shortened_after_a_late_one(lateness: list[float], period: float) -> None:
    due, ticks = 10.0, [10.0 - period]
    for late in lateness:
        ticks.append(due + late)
        due = next_tick(due, period, ticks[-1])
    assert min(np.diff(ticks)) >= (1 - SLACK) * period - 1e-9
    if max(lateness) <= SLACK * period:  # small delays do not add up
        assert due == pytest.approx(10.0 + period * len(lateness))


@given(
    st.lists(st.floats(0.0, 0.3) | st.none(), min_size=5, max_size=5),
    st.lists(st.floats(0.0, 0.04), min_size=5, max_size=5),
)
def test_the_number_of_misses_decides_for_any_delays(delays: list[float | None], lateness: list[float]) -> None:
    episode = begun()
    delays[0] = delays[0] or 0.0
    sent = play(episode, delays, lateness=lateness)
    episodes, execution = episode.ended()
    missed = int((execution.flags & MISSED > 0).sum())
    assert missed <= TASK.misses_allowed
    assert (episode.misses > TASK.misses_allowed) == ("too late" in episode.discard_reason)
    steps = len(execution.flags)
    assert steps == episodes.mask.sum() == len(execution.stamps) - 1
    assert len(sent) >= steps - missed
    gaps = np.diff([at for at, _ in sent])
    assert (gaps > 0).all()
    if not episode.discard_reason:
        np.testing.assert_allclose(episodes.actions[0, :, 0], 0.1 * np.arange(1, 6))


def test_without_a_report_a_command_counts_as_executed() -> None:
    episode = begun()
    sent = play(episode, [0.01] * 5, reports=False)
    execution = episode.ended()[1]
    assert (execution.flags == NO_REPORT).all()
    np.testing.assert_array_equal(execution.executed[:, 0], [value for _, value in sent])


def test_a_refused_command_discards_the_episode() -> None:
    episode = begun()
    episode.act(0, np.zeros(1), 0.0)
    episode.report(0, np.zeros(1), Flags.NOT_ARMED)
    assert episode.over
    assert episode.discard_reason == "the gate refused the command of step 0"


def test_a_stale_sensor_discards_the_episode() -> None:
    episode = begun()
    episode.act(0, np.zeros(1), 0.0)

    def stale() -> Reading:
        raise SensingError("sensor position: stale")

    assert not episode.proceed(PERIOD, stale)
    assert episode.discard_reason == "sensor position: stale"
    assert not episode.ended()[0].mask.any()


def test_the_task_ends_the_episode_before_the_horizon() -> None:
    episode = begun()
    episode.act(0, np.zeros(1), 0.0)
    episode.report(0, np.zeros(1), 0)
    assert episode.proceed(PERIOD, sensed(51.0))
    episodes, _ = episode.ended()
    assert episode.over
    assert (episodes.terminated.tolist(), episodes.mask.sum()) == ([True], 1)


def test_unexpected_actions_are_ignored() -> None:
    episode = RobotEpisode(BATCH, TASK, stamp=0)
    assert episode.act(0, np.zeros(1), 0.0) is None  # nothing was observed yet
    episode.begin(sensed(0.0)())
    assert episode.act(1, np.zeros(1), 0.0) is None
    assert episode.act(0, np.zeros(1), 0.0) is not None
    assert episode.act(0, np.ones(1), 0.01) is None
    episode.discard("stopped")
    assert episode.act(0, np.ones(1), 0.01) is None


@pytest.mark.parametrize("rule", ["reward", "end"])
def test_steps_before_a_failing_rule_are_complete(rule: str) -> None:
    breaking = "test.unit.robot.robot_rules:breaks"
    changes = {"reward": Reward(function=breaking)} if rule == "reward" else {"end": End(function=breaking)}
    episode = begun(replace(TASK, **changes))
    with pytest.raises(RunError, match=f"{rule} function: ZeroDivisionError"):
        play(episode, [0.01] * 5)
    _, execution = episode.ended()
    assert len(execution.flags) == 2
    assert len(execution.stamps) == 3
