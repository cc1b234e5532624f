"""The part of the page that shows an iteration: its policy, and one of its episodes as it moves."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Any

from viser import ViserServer

from rkhs_ros.base.endings import error_message
from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rollouts.visualization import BodyTrajectories
from rkhs_ros.sketches.policy_coordinates import PolicyCoordinates
from rkhs_ros.view.board import Choice, Subject, draw
from rkhs_ros.view.source import MOST_IMAGINED, IterationView, Source
from rkhs_ros.view.stage import Stage
from rkhs_ros.view.tasks import look_of
from rkhs_ros.view.timeline import Timeline

LONGEST_PLAY_S = 8.0  # of an episode; a longer one is played faster
MOST_LISTED = 20  # episodes of a kind in the list
MOST_TOLD = 8  # numbers of a moment
EXPLORING, NOISE_FREE, IMAGINED = "exploring", "noise-free", "imagined"


class IterationPanel:
    """The episode that is looked at, with the controls that choose it.

    Owns these, the stage, and what was shown last.

    Attributes:
        episode: that is looked at, a single row; None at first.
        words: what is told of a moment of it.

    Args:
        server: of the page.
        source: the run.
    """

    def __init__(self, server: ViserServer, source: Source) -> None:
        self._server, self._source = server, source
        gui = server.gui
        self._which = gui.add_dropdown("Episode", ("-",))
        self._frame: Any = gui.add_slider("Time", 0, 1, 1, 0, disabled=True)
        self._set_to = 0
        self._plays: Any = gui.add_checkbox("play", initial_value=True)
        self.words = gui.add_markdown("")
        self._choices: tuple[Any, ...] = ()
        self._stage: Stage | None = None
        self.forget()

    def forget(self) -> None:
        """Forget what is shown, which is then shown anew."""
        self._shown: object = None
        self.episode: Episodes | None = None
        self._motion: BodyTrajectories | None = None
        self._at = -1  # the frame that is shown
        self._trouble = ""

    def is_of(self, iteration: int) -> bool:
        """Return whether it is this iteration that is shown, as the controls say."""
        return self._shown == self._chosen(iteration)

    def show(self, seen: Mapping[int, IterationView]) -> None:
        """Show the last of some iterations, with the episodes of those before."""
        if not seen:
            return
        iteration, newest = max(seen.items())
        self._list(newest)
        kind, _, number = self._which.value.partition(" ")
        self._trouble, row = "", int(number) - 1 if number else 0
        episodes = self._imagined(newest) if kind == IMAGINED else _of_kind(newest, kind)
        if episodes is None:
            kind, row = EXPLORING, 0
            episodes = _of_kind(newest, kind)
        if episodes is not None:
            self.episode = episodes.take(slice(row, row + 1))
            self._set_motion(newest, self.episode)
            self._hang(seen, iteration, kind)
        self._shown = self._chosen(iteration)

    def move(self) -> None:
        """Play on, and show the moment that is chosen."""
        if self.episode is None or self._stage is None:
            return
        if self._frame.value != self._set_to:  # by somebody
            self._plays.value = False
        if self._plays.value and self._motion is not None:
            self._play(self._motion)
        self._set_to = frame = int(self._frame.value)
        if frame != self._at:
            self._at = frame
            steps, frames = int(self.episode.mask[0].sum()), int(self._frame.max) + 1
            step = min(frame * steps // frames, steps - 1)
            self._stage.show(self._motion, min(frame, self._frames - 1), step)
            self.words.content = self._told(self.episode, step, steps)

    def _chosen(self, iteration: int) -> tuple[object, ...]:
        return iteration, self._which.value, *(each.value for each in self._choices)

    def _list(self, seen: IterationView) -> None:
        counts = {kind: len(_of_kind(seen, kind) or ()) for kind in (NOISE_FREE, EXPLORING)}
        counts[IMAGINED] = MOST_IMAGINED if seen.imagine is not None else 0
        listed = [f"{kind} {i + 1}" for kind, count in counts.items() for i in range(min(count, MOST_LISTED))]
        if listed and listed != list(self._which.options):
            self._which.options = listed

    def _imagined(self, seen: IterationView) -> Episodes | None:
        """Return what the model expects; None where that cannot be said, and why is told beside what is shown."""
        try:
            return None if seen.imagine is None else seen.imagine()
        except Exception as error:  # of a function of somebody's
            self._trouble = f"Nothing can be imagined ({error_message(error)}): an exploring episode in its place. "
            return None

    def _offer_choices(self, coordinates: PolicyCoordinates, episode: Episodes) -> None:
        """Add what the policy can be drawn over, in a folder that is closed: what tells most is chosen already."""
        labels, (across, up) = coordinates.labels, coordinates.telling(episode)
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

    def _set_motion(self, seen: IterationView, episode: Episodes) -> None:
        """Set how an episode moves; the first one sets up the stage and what the policy can be drawn over."""
        going = episode.mask[0]
        numbers = episode.observations[0][going], self._clipped(episode.actions[0][going])
        task, spaces, nodes = self._source.task, self._source.spaces, self._source.nodes
        if self._stage is None:
            self._names, self._scene = look_of(task, spaces, nodes, *numbers)
            self._stage = Stage(self._server, self._scene)
            self._offer_choices(PolicyCoordinates(seen.policy, self._names), episode)
        self._motion = None
        try:
            self._motion = self._scene.motion(*numbers)
        except Exception as error:  # somebody's code
            print(f"warning: {task.environment}: not shown ({error_message(error)})", file=sys.stderr)
        if isinstance(self._scene, Timeline):
            self._stage.set_backdrop(self._scene.backdrop(*numbers))
        self._frames = int(going.sum()) if self._motion is None else len(self._motion.times)
        self._frame.max, self._frame.disabled = max(self._frames - 1, 1), self._frames < 2
        self._frame.value = self._set_to = min(self._set_to, self._frames - 1)  # at the moment as before
        self._at, self._played_at = -1, time.monotonic()

    def _hang(self, seen: Mapping[int, IterationView], iteration: int, kind: str) -> None:
        """Draw the policy with the episodes that led to it, that looked at last."""
        one_step = self._source.task.horizon == 1
        recent = [_of_kind(each, EXPLORING if one_step else kind) for number, each in sorted(seen.items())]
        before = [each for each in (recent if one_step else recent[:-1]) if each]
        rows = [each.take(slice(i, i + 1)) for each in before for i in range(len(each) if one_step else 1)]
        coordinates = PolicyCoordinates(seen[iteration].policy, self._names)
        across, up, action = (each.value for each in self._choices)
        choice = Choice(
            coordinates.labels.index(across), coordinates.labels.index(up), self._names.actions.index(action)
        )
        what = "Policy after" if coordinates.policy else "Episodes of"
        title, task = f"{what} iteration {iteration}", self._source.task
        if self._stage is not None and self.episode is not None:
            subject = Subject(title, coordinates, [*rows, self.episode], self._source.spaces, task.discount)
            self._stage.hang(draw(subject, choice))

    def _play(self, motion: BodyTrajectories) -> None:
        """Move the slider to where it is by now, round and round."""
        now = time.monotonic()
        period = min(float(motion.times[-1]), LONGEST_PLAY_S) / max(self._frames - 1, 1)
        passed = int((now - self._played_at) / max(period, 1e-3))
        if passed:
            self._frame.value = (int(self._frame.value) + passed) % self._frames
            self._played_at = now

    def _clipped(self, actions: Array) -> Array:
        return actions if self._source.spaces is None else self._source.spaces.clip(actions)

    def _told(self, episode: Episodes, step: int, steps: int) -> str:
        """Return in words what is observed, done and earned in a step."""
        done = self._clipped(episode.actions[0, step][None])[0]
        numbers = [*zip(self._names.observations, episode.observations[0, step], strict=True)]
        numbers += [*zip(self._names.actions, done, strict=True)]
        error_message = [
            f"{name} **{value:.3g}**" for name, value in [*numbers[:MOST_TOLD], ("reward", episode.rewards[0, step])]
        ]
        return f"{self._trouble}Step {step + 1} of {steps}: {', '.join(error_message)}"


def _of_kind(seen: IterationView, kind: str) -> Episodes | None:
    return seen.evaluation if kind == NOISE_FREE else seen.exploration
