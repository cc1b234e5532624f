"""The page: what is seen of a run, and the controls with which somebody moves through it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import lru_cache
from math import isnan
from typing import Any

import numpy as np
from viser import ViserServer

from rkhs_ros.learning.episodes import Episodes
from rkhs_ros.pictures.run_pictures import references
from rkhs_ros.runs.control import PAUSE, RESUME, STOP, ask
from rkhs_ros.runs.curve import Row
from rkhs_ros.runs.shown import Motion
from rkhs_ros.view.board import Choice, Subject, draw
from rkhs_ros.view.coordinates import Coordinates
from rkhs_ros.view.curve_plot import CurvePlot
from rkhs_ros.view.gauges import Gauges
from rkhs_ros.view.source import ENDED, FINISHED, PAUSED, RUNNING, Seen, Source, state_of
from rkhs_ros.view.stage import Stage
from rkhs_ros.view.tasks import in_space, names_of

KEPT = 12  # iterations whose policy and episodes stay in memory
RECENT = 6  # iterations whose episodes are drawn beside the chosen one
LONGEST_PLAY_S = 8.0  # of an episode; a longer one is played faster
MOST_LISTED = 20  # episodes of a kind in the list
EXPLORING, NOISE_FREE = "exploring", "noise-free"


class Page:
    """The page of a run.

    Owns its controls and what they showed last. `refresh` looks at the run anew, `tick` at the controls.

    Args:
        server: that serves the page.
        source: the run.
    """

    def __init__(self, server: ViserServer, source: Source) -> None:
        self._server = server
        self._source = source
        self._seen = lru_cache(KEPT)(source.seen)
        self._state = ""
        self._stage: Stage | None = None
        self._episode: Episodes | None = None
        self._motion: Motion | None = None
        self._drawn: object = None
        self._moment: object = None
        self._played_at = time.monotonic()
        self._build()

    def _build(self) -> None:
        gui = self._server.gui
        gui.configure_theme(control_layout="fixed", control_width="large", show_logo=False, show_share_button=False)
        gui.set_panel_label(self._source.name)
        self._status = gui.add_markdown("", order=0)
        self._buttons = {
            word: gui.add_button(label, hint=hint, order=1, visible=False)
            for word, label, hint in (
                (PAUSE, "Pause after this iteration", "the run waits until it is resumed"),
                (RESUME, "Resume", "the run goes on"),
                (STOP, "Stop", "as Ctrl-C: what was learnt is kept, and the run can go on later"),
            )
        }
        for word, button in self._buttons.items():
            button.on_click(lambda _, word=word: self._ask(word))
        self._curve = CurvePlot(gui, references(self._source.task))
        self._iteration: Any = gui.add_slider("Iteration", 0, 1, 1, 0, disabled=True, order=3)
        self._follow = gui.add_checkbox("follow the newest", initial_value=True, order=4)
        self._kind = gui.add_dropdown("Episode", ("-",), order=5)
        self._frame: Any = gui.add_slider("Time", 0, 1, 1, 0, disabled=True, order=6)
        self._play = gui.add_checkbox("play", initial_value=True, order=7)
        self._words = gui.add_markdown("", order=8)
        self._choices: tuple[Any, ...] = ()

    def refresh(self) -> None:
        """Look at the run: at its state, its curve, and whether there is a newer iteration to follow."""
        self._source.refresh()
        state = state_of(self._source)
        if state != self._state:
            self._seen.cache_clear()  # at the end there is more of the last one
            self._drawn = None
        self._state = state
        self._buttons[PAUSE].visible = state == RUNNING
        self._buttons[RESUME].visible = state == PAUSED
        self._buttons[STOP].visible = state in (RUNNING, PAUSED)
        self._status.content = status(self._source, state)
        self._curve.draw(self._source.rows)
        self._follow_newest()

    def tick(self) -> None:
        """Show what the controls say, if it is not shown yet."""
        self._see()
        if self._motion is not None or self._episode is not None:
            self._move()

    def tell_end(self) -> None:
        """Say on the page that it will show nothing new any more."""
        self._status.content = "### The viewer has ended\nStart it again with `rkhs view`."
        self._server.flush()

    def _ask(self, word: str) -> None:
        if self._buttons[word].visible:
            ask(self._source.path, word)

    def _follow_newest(self) -> None:
        iterations = self._source.iterations
        if not iterations:
            return
        slider = self._iteration
        moved = slider.value != getattr(self, "_set_iteration", slider.value)
        if moved:
            self._follow.value = False
        if slider.max != iterations[-1] or slider.disabled:
            slider.min, slider.max, slider.disabled = min(iterations[0], iterations[-1] - 1), iterations[-1], False
        if self._follow.value:
            slider.value = iterations[-1]
        self._set_iteration = slider.value

    def _see(self) -> None:
        """Show the policy and the episode that are chosen."""
        chosen = (self._iteration.value, self._kind.value, *(each.value for each in self._choices))
        if chosen == self._drawn or not self._source.iterations:
            return
        known = [number for number in self._source.iterations if number <= self._iteration.value]
        seen = self._seen(known[-1]) if known else None
        if seen is None:
            return
        self._list_episodes(seen)
        row, kind = self._chosen_row()
        episodes = _of_kind(seen, kind)
        self._episode = None if episodes is None else episodes.take(slice(row, row + 1))
        if self._episode is None:
            return
        self._offer_choices(seen)
        self._set_motion(self._episode)
        self._hang(seen, known, kind)
        self._drawn = (self._iteration.value, self._kind.value, *(each.value for each in self._choices))
        self._moment = None

    def _list_episodes(self, seen: Seen) -> None:
        kinds = ((NOISE_FREE, seen.evaluation), (EXPLORING, seen.exploration))
        listed = [f"{kind} {i + 1}" for kind, each in kinds if each for i in range(min(len(each), MOST_LISTED))]
        if listed and tuple(listed) != tuple(self._kind.options):
            self._kind.options = tuple(listed)

    def _chosen_row(self) -> tuple[int, str]:
        kind, _, number = self._kind.value.partition(" ")
        return (int(number) - 1 if number else 0), kind

    def _offer_choices(self, seen: Seen) -> None:
        """Make the lists of what the policy is drawn over, once it is known what there is."""
        if self._choices or self._episode is None:
            return
        gui, widths = self._server.gui, (self._episode.observations.shape[2], self._episode.actions.shape[2])
        task = self._source.task
        self._observations, self._actions = (
            tuple(names_of(task, kind, width)) for kind, width in zip(("observation", "action"), widths, strict=True)
        )
        labels = Coordinates(seen.policy, self._observations).labels
        self._choices = tuple(
            gui.add_dropdown(name, tuple(options), initial_value=options[first], visible=len(options) > fewest, order=9)
            for name, options, first, fewest in (
                ("Policy across", labels, 0, 2),
                ("Policy up", labels, min(1, len(labels) - 1), 2),
                ("Action", self._actions, 0, 1),
            )
        )
        self._task = in_space(task) or Gauges(*widths)
        self._stage = Stage(self._server, self._task)

    def _set_motion(self, episode: Episodes) -> None:
        going = episode.mask[0]
        actions = episode.actions[0][going]
        clipped = actions if self._source.spaces is None else self._source.spaces.clip(actions)
        self._motion = self._task.motion(episode.observations[0][going], clipped)
        assert_stage = self._stage
        if assert_stage is not None:
            assert_stage.settle(self._motion)
        frames = int(going.sum()) if self._motion is None else len(self._motion.times)
        self._frame.max, self._frame.disabled = max(frames - 1, 1), frames < 2
        self._frame.value = self._set_frame = 0
        self._played_at = time.monotonic()

    def _hang(self, seen: Seen, known: Sequence[int], kind: str) -> None:
        recent = [self._seen(number) for number in known[-RECENT:-1]]
        before = [_of_kind(each, kind) for each in recent if each is not None]
        rows = [each.take(slice(i, i + 1)) for each in before if each for i in range(self._drawn_of(each))]
        coordinates = Coordinates(seen.policy, self._observations)
        labels = coordinates.labels
        x, y, action = (each.value for each in self._choices)
        choice = Choice(labels.index(x), labels.index(y), self._actions.index(action))
        title = f"Policy after iteration {known[-1]}"
        episodes = [*rows, *([self._episode] if self._episode else [])]
        subject = Subject(title, coordinates, episodes, self._actions, self._source.spaces, self._source.task.discount)
        if self._stage is not None:
            self._stage.hang(draw(subject, choice))

    def _drawn_of(self, episodes: Episodes) -> int:
        return len(episodes) if episodes.horizon == 1 else 1

    def _move(self) -> None:
        """Play on, and show the moment that is chosen."""
        now, frames = time.monotonic(), int(self._frame.max) + 1
        if self._frame.value != self._set_frame:
            self._play.value = False
        if self._play.value and not self._frame.disabled and self._motion is not None:
            period = float(self._motion.times[-1]) / max(frames - 1, 1)
            period = min(period, LONGEST_PLAY_S / frames)
            passed = int((now - self._played_at) / max(period, 1e-3))
            if passed:
                self._frame.value = (int(self._frame.value) + passed) % frames
                self._played_at = now
        self._set_frame = self._frame.value
        if self._moment != self._frame.value and self._stage is not None and self._episode is not None:
            self._moment = frame = int(self._frame.value)
            steps = int(self._episode.mask[0].sum())
            step = min(frame * steps // frames, steps - 1)
            self._stage.show(self._motion, frame if self._motion is not None else 0, step)
            self._words.content = self._told(step, steps)

    def _told(self, step: int, steps: int) -> str:
        """Return in words what is observed and done in a step."""
        assert_episode: Any = self._episode
        done = assert_episode.actions[0, step]
        clipped = done if self._source.spaces is None else self._source.spaces.clip(done[None])[0]
        pairs = [*zip(self._observations, assert_episode.observations[0, step], strict=True)]
        pairs += [*zip(self._actions, clipped, strict=True)]
        numbers = ", ".join(f"{name} {value:.3g}" for name, value in pairs[:8])
        return f"Step {step + 1} of {steps}: {numbers}, reward {assert_episode.rewards[0, step]:.3g}"


def _of_kind(seen: Seen, kind: str) -> Episodes | None:
    return seen.evaluation if kind == NOISE_FREE else seen.exploration


def status(source: Source, state: str) -> str:
    """Return in Markdown how far a run is."""
    rows = source.rows
    lines = [f"### {state.capitalize()}: iteration {len(rows)} of {source.total}"]
    if rows:
        last = rows[-1]
        lines.append(f"{last.episodes} episodes, {last.centres} centres, {clock(last.seconds)}{left(source, state)}")
        lines.append(f"Return **{last.train_return:.4g}** exploring{measured(rows)}")
    return "\n\n".join([*lines, f"`{source.task.environment}` in `{source.path}`"])


def measured(rows: Sequence[Row]) -> str:
    """Return the last noise-free and imagined returns in words; nothing of those that there are not."""
    noise_free = next((row.mean_policy_return for row in reversed(rows) if not isnan(row.mean_policy_return)), None)
    imagined = rows[-1].imagined_return
    text = "" if noise_free is None else f", **{noise_free:.4g}** noise-free"
    return text + ("" if isnan(imagined) else f", {imagined:.4g} imagined")


def left(source: Source, state: str) -> str:
    """Return how long a run will take still, by the pace of its last iterations; nothing of one not running."""
    rows, some = source.rows, source.rows[-20:]
    if state != RUNNING or len(some) < 2:
        return ""
    pace = float(np.mean(np.diff([row.seconds for row in some])))
    return f", about {clock(max(pace, 0.0) * (source.total - len(rows)))} left"


def clock(seconds: float) -> str:
    """Return a time as people say it."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"
