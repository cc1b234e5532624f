"""Show one iteration on the page: its policy, and an animation of one of its episodes."""

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from viser import ViserServer

from rkhs_ros.base.endings import error_message
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.known import BodyTrajectories
from rkhs_ros.pictures.policy_axes import PolicyAxes
from rkhs_ros.pictures.policy_figure import draw_attempts, draw_policy
from rkhs_ros.pictures.style import legend_above, pixels, sheet
from rkhs_ros.view.recorded import MODEL_ROLLOUTS, IterationView, Recorded
from rkhs_ros.view.scenes import appearance_of
from rkhs_ros.view.stage import SIZE, Stage
from rkhs_ros.view.timeline import Timeline

LONGEST_PLAY_S = 8.0  # longer episodes are played faster
STILL_S = 0.1  # for which a step without motion is shown
MAX_LISTED = 20  # episodes of each kind in the list
MAX_NUMBERS = 8  # in the description of a step
EXPLORATION, EVALUATION, MODEL = "exploration", "evaluation", "model rollout"


class IterationPanel:
    """The selected episode and policy, with the controls that select them.

    Owns these controls, the stage, and the current selection: the episode, alone, and the description of its step.
    """

    def __init__(self, server: ViserServer, source: Recorded) -> None:
        self._server, self._source = server, source
        gui = server.gui
        self._which = gui.add_dropdown("Episode", ("-",))
        self._frame: Any = gui.add_slider("Time", 0, 1, 1, 0, disabled=True)
        self._set_to = 0
        self._plays: Any = gui.add_checkbox("play", initial_value=True)
        self.text = gui.add_markdown("")
        self._choices: tuple[Any, ...] = ()
        self._stage: Stage | None = None
        self.reset()

    def reset(self) -> None:
        """Discard the current selection, so that `show` draws it again."""
        self._shown: object = None
        self.episode: Episodes | None = None
        self._motion: BodyTrajectories | None = None
        self._at = -1  # the current frame

    def is_showing(self, iteration: int) -> bool:
        """Return whether the page shows this iteration with the current settings of the controls."""
        return self._shown == self._chosen(iteration)

    def show(self, iterations: Mapping[int, IterationView]) -> None:
        """Show the last of the given iterations, with the episodes of the earlier ones in the policy plot."""
        if not iterations:
            return
        iteration, newest = max(iterations.items())
        self._list(newest)
        kind, _, number = self._which.value.rpartition(" ")
        row, episodes = int(number) - 1 if kind else 0, newest.exploration
        if kind == MODEL and newest.roll_out_model is not None:
            episodes = newest.roll_out_model()
        elif kind == EVALUATION and newest.evaluation is not None:
            episodes = newest.evaluation
        elif kind != EXPLORATION:
            kind, row = EXPLORATION, 0
        self.episode = episodes.take(slice(row, row + 1))
        self._set_motion(newest, self.episode)
        self._draw_policy(iterations, iteration, kind)
        self._shown = self._chosen(iteration)

    def move(self) -> None:
        """Advance the animation and show the selected moment."""
        if self.episode is None or self._stage is None:
            return
        if self._frame.value != self._set_to:  # a user moved the slider
            self._plays.value = False
        if self._plays.value and self._motion is not None:
            self._play(self._motion)
        self._set_to = frame = int(self._frame.value)
        if frame != self._at:
            self._at = frame
            steps, frames = int(self.episode.mask[0].sum()), int(self._frame.max) + 1
            step = min(frame * steps // frames, steps - 1)
            self._stage.show(self._motion, min(frame, self._frames - 1), step)
            self.text.content = self._step_text(self.episode, step, steps)

    def play_once(self, wait: Callable[[float], None]) -> None:
        """Show each moment of the selected episode in turn, and wait for its duration in seconds."""
        self._plays.value = False
        for frame in range(int(self._frame.max) + 1):
            self._frame.value = self._set_to = frame
            self.move()
            wait(STILL_S if self._motion is None else self._seconds_of_frame(self._motion))

    def _chosen(self, iteration: int) -> tuple[object, ...]:
        return iteration, self._which.value, *(each.value for each in self._choices)

    def _list(self, view: IterationView) -> None:
        counts = {EVALUATION: len(view.evaluation or ()), EXPLORATION: len(view.exploration)}
        counts[MODEL] = MODEL_ROLLOUTS if view.roll_out_model is not None else 0
        listed = [f"{kind} {i + 1}" for kind, count in counts.items() for i in range(min(count, MAX_LISTED))]
        if listed and listed != list(self._which.options):
            self._which.options = listed

    def _offer_choices(self, axes: PolicyAxes, episode: Episodes) -> None:
        """Add the controls for the plot's axes in a closed folder; the most informative axes are preselected."""
        labels, across, up = axes.labels, 0, min(len(axes.labels) - 1, 1)
        if len(labels) > 2:
            (across, up), _ = axes.most_informative(axes.visited(episode)[0], self._source.spaces)
        lists = (("across", labels, across, 2), ("up", labels, up, 2), ("action", self._names.actions, 0, 1))
        gui, moves = self._server.gui, self._source.task.horizon > 1
        is_choice = moves and any(len(options) > fewest for _, options, _, fewest in lists)
        with gui.add_folder("Axes of the policy", expand_by_default=False, visible=is_choice):
            self._choices = tuple(
                gui.add_dropdown(
                    name, tuple(options), initial_value=options[first], visible=moves and len(options) > fewest
                )
                for name, options, first, fewest in lists
            )

    def _set_motion(self, view: IterationView, episode: Episodes) -> None:
        """Set the motion of an episode; the first call sets up the stage and the controls for the axes."""
        going = episode.mask[0]
        numbers = episode.observations[0][going], self._source.spaces.clip(episode.actions[0][going])
        task, spaces, nodes = self._source.task, self._source.spaces, self._source.nodes
        if self._stage is None:
            self._names, self._scene = appearance_of(task, spaces, nodes, *numbers)
            self._stage = Stage(self._server, self._scene, has_depth=not isinstance(self._scene, Timeline))
            self._axes = PolicyAxes.of(view.policy, self._names, episode)
            self._offer_choices(self._axes, episode)
        self._motion = None
        try:
            self._motion = self._scene.motion(*numbers)
        except Exception as error:  # from a user's task
            print(f"warning: {task.environment}: cannot show the episode ({error_message(error)})", file=sys.stderr)
        if isinstance(self._scene, Timeline):
            self._stage.set_backdrop(pixels(self._scene.figure(*numbers)))
        self._frames = int(going.sum()) if self._motion is None else len(self._motion.times)
        self._frame.max, self._frame.disabled = max(self._frames - 1, 1), self._frames < 2
        self._frame.value = self._set_to = min(self._set_to, self._frames - 1)  # stays at the same moment
        self._at, self._played_at = -1, time.monotonic()

    def _draw_policy(self, iterations: Mapping[int, IterationView], iteration: int, kind: str) -> None:
        """Draw the policy with the latest episodes, the selected one last."""
        one_step = self._source.task.horizon == 1
        evaluated = kind == EVALUATION and not one_step
        recent = [each.evaluation if evaluated else each.exploration for _, each in sorted(iterations.items())]
        before = [each for each in (recent if one_step else recent[:-1]) if each]
        rows = [each.take(slice(i, i + 1)) for each in before for i in range(len(each) if one_step else 1)]
        if self._stage is None or self.episode is None:
            return
        source, episodes = self._source, [*rows, self.episode]
        figure = sheet(*SIZE, f"Policy after iteration {iteration}")
        plot = figure.subplots()
        if one_step:
            points = draw_attempts(plot, Episodes.concatenate(episodes), self.episode, source.spaces, self._names, None)
        else:
            axes = replace(self._axes, policy=iterations[iteration].policy)
            across, up, action = (each.value for each in self._choices)
            pair = axes.labels.index(across), axes.labels.index(up)
            points = draw_policy(plot, axes, source.spaces, episodes, pair, self._names.actions.index(action))
        legend_above(plot)
        self._stage.set_picture(figure, points)

    def _play(self, motion: BodyTrajectories) -> None:
        """Move the slider to the current time of the looping animation."""
        now = time.monotonic()
        passed = int((now - self._played_at) / self._seconds_of_frame(motion))
        if passed:
            self._frame.value = (int(self._frame.value) + passed) % self._frames
            self._played_at = now

    def _seconds_of_frame(self, motion: BodyTrajectories) -> float:
        return max(min(float(motion.times[-1]), LONGEST_PLAY_S) / max(self._frames - 1, 1), 1e-3)

    def _step_text(self, episode: Episodes, step: int, steps: int) -> str:
        done = self._source.spaces.clip(episode.actions[0, step][None])[0]
        numbers = [*zip(self._names.observations, episode.observations[0, step], strict=True)]
        numbers += [*zip(self._names.actions, done, strict=True)]
        shown = [*numbers[:MAX_NUMBERS], ("reward", episode.rewards[0, step])]
        parts = [f"{name} **{value:.3g}**" for name, value in shown]
        return f"Step {step + 1} of {steps}: {', '.join(parts)}"
