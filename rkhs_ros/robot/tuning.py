"""Tuning of a node's parameters: which ones, within which ranges, what happens in a trial, and what to try next."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import ceil, floor
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from rkhs_ros.base.settings import Settings, build, build_section, setting
from rkhs_ros.base.validation import hint, require
from rkhs_ros.policies.streams import stream
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.rkhs.posterior import Posterior, spread_points
from rkhs_ros.robot.sensors import Sensors
from rkhs_ros.robot.task import Reward, sensors_from

SCALES = ("linear", "log")
CENTRES = 200  # of the model of the reward
ANYWHERE, NEARBY = 1000, 300  # candidates for a trial in the ranges, and at each distance from the best trial
NEARBY_SD = (0.03, 0.1, 0.3)  # these distances
SLACK = 1e-9  # of the ends of a range in steps, for rounding errors
LEAST_SD = 1e-12  # of the reward, to divide by
NEAR, FEWEST_PAIRS = 0.03, 5  # distance of two trials whose rewards differ by noise, and how many such pairs show it


@dataclass(frozen=True)
class Parameter(Settings):
    """The range of a parameter."""

    minimum: float = setting(0.0, "least value", minimum=-1e12, maximum=1e12)
    maximum: float = setting(1.0, "greatest value", minimum=-1e12, maximum=1e12)
    scale: str = setting("linear", "scale of the range; log: for values of different magnitudes", choices=SCALES)

    def __post_init__(self) -> None:
        """Raise ValueError if the range is empty, or a logarithmic one is not positive."""
        super().__post_init__()
        require(self.minimum < self.maximum, "minimum", f"less than the maximum, {self.maximum:g}", self.minimum)
        require(self.scale == "linear" or self.minimum > 0.0, "minimum", "more than 0 for scale: log", self.minimum)

    def place(self, value: float) -> float:
        """Return the place of a value in the range, from -1 to 1."""
        low, high = self.minimum, self.maximum
        share = np.log(value / low) / np.log(high / low) if self.scale == "log" else (value - low) / (high - low)
        return float(2.0 * share - 1.0)

    def value(self, place: float, *, origin: float = 0.0, step: float = 0.0) -> float:
        """Return the value at a place of the range, from -1 to 1; the nearest one in steps from an origin, if any."""
        low, high, share = self.minimum, self.maximum, 0.5 * (1.0 + place)
        value = low * (high / low) ** share if self.scale == "log" else low + share * (high - low)
        value = min(max(value, low), high)  # rounding errors are outside, and the node would reject them
        if step > 0.0:
            first, last = ceil((low - origin) / step - SLACK), floor((high - origin) / step + SLACK)
            value = origin + step * min(max(round((value - origin) / step), first), last)
        return float(value)


@dataclass(frozen=True)
class Trial(Settings):
    """What happens in a trial after the parameters are set."""

    seconds: float = setting(2.0, "how long the sensors are recorded", minimum=1e-3, maximum=86400.0)
    period: float = setting(0.02, "seconds between two records", minimum=1e-3, maximum=3600.0)
    settle: float = setting(0.0, "seconds to wait after the parameters are set", minimum=0.0, maximum=3600.0)
    service: str = setting("", "service of type std_srvs/srv/Trigger that starts the trial; empty for none")
    topic: str = setting("", "topic of type std_msgs/msg/Empty that starts the trial; empty for none")


@dataclass(frozen=True)
class Tuning(Settings):
    """The tuning of the parameters of one node: their ranges by name, and the sensors that a trial records."""

    node: str = setting("", "name of the node whose parameters are tuned")
    trials: int = setting(30, "maximum number of trials", minimum=8, maximum=10_000)
    context: tuple[str, ...] = setting(
        (), "names of the observed values that the parameters depend on, as they are when a trial starts"
    )
    rejected: float = setting(-1.0, "reward of a trial whose parameters the node rejects", minimum=-1e9, maximum=1e9)
    timeout: float = setting(10.0, "seconds after which a silent node ends the run", minimum=0.1, maximum=3600.0)
    stale_after: float = setting(0.5, "seconds after which a sensor's message is stale", minimum=1e-3, maximum=3600.0)
    trial: Trial = Trial()
    reward: Reward = Reward()
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    sensors: Sensors = field(default=Sensors({}, 0.5))

    def places(self, values: Mapping[str, float]) -> Array:
        """Return the places of values in their ranges, shape (n,)."""
        return np.array([each.place(values[name]) for name, each in self.parameters.items()])


def tuning_from(tree: Mapping[str, Any]) -> Tuning:
    """Return the tuning of a configuration; raise ValueError for an unknown key or an invalid value."""
    require(isinstance(tree, Mapping), "configuration", "a section of keys", repr(tree))
    ranges = tree.get("parameters", {})
    require(isinstance(ranges, Mapping) and len(ranges) > 0, "parameters", "a section for each parameter", ranges)
    tuning = build(Tuning, {key: each for key, each in tree.items() if key not in ("parameters", "sensors")})
    require(tuning.node != "", "node", "the name of a node", "none")
    require(bool(tuning.reward.function or tuning.reward.topic), "reward", "a function or a topic", "neither")
    sensors = Sensors(sensors_from(tree.get("sensors", {})), tuning.stale_after)
    for name in tuning.context:
        if name not in sensors.names:
            raise ValueError(f"context: unknown value '{name}', {hint(name, dict.fromkeys(sensors.names))}")
    parameters = {str(name): build_section(Parameter, each, f"parameters.{name}") for name, each in ranges.items()}
    _ = tuning.reward.rule  # raises if it cannot be imported
    return replace(tuning, parameters=parameters, sensors=sensors)


class Trials(NamedTuple):
    """Finished trials: contexts, shape (n, c), places of the parameters in their ranges, (n, p), and rewards, (n,)."""

    contexts: Array
    places: Array
    rewards: Array

    @property
    def points(self) -> Array:
        """Contexts and places, the inputs of the model of the reward."""
        return np.concatenate([self.contexts, self.places], axis=1)


def next_places(trials: Trials, context: Array, seed: int) -> tuple[Array, float]:
    r"""Return the places of the parameters to try next, shape (p,), and the expected improvement there.

    The first trials are spread over the ranges. Then, with mean m and standard deviation s of the posterior of the
    reward and the greatest mean m* of the trials, the candidate with the greatest expected improvement is tried (Jones,
    Schonlau and Welch, 1998):

    .. math:: s\, \big(z \Phi(z) + \phi(z)\big), \qquad z = (m - m^*) / s

    The context has the shape (c,), and the seed is that of the run.
    """
    number, size = trials.places.shape
    if number < 2 * (size + 1):  # of at least as many spread points
        return 2.0 * spread_points(2 ** (size + 1), size, seed)[number] - 1.0, np.inf
    posterior, candidates = _model(trials, context, stream(seed, "tuning", number))
    mean, sd = posterior.mean(candidates)[:, 0], np.maximum(posterior.sd(candidates)[:, 0], LEAST_SD)
    z = (mean - posterior.mean(trials.points).max()) / sd
    gains = sd * (z * ndtr(z) + np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi))
    return np.asarray(candidates[gains.argmax(), len(context) :]), float(gains.max())


def noise_of(trials: Trials) -> float:
    """Return the noise of the reward, the median difference of trials that nearly repeat others; 0 without enough."""
    differences = trials.points[:, None] - trials.points
    pairs = np.argwhere(np.triu(np.linalg.norm(differences, axis=2) < NEAR, k=1))
    return float(np.median(np.abs(np.diff(trials.rewards[pairs], axis=1)))) if len(pairs) >= FEWEST_PAIRS else 0.0


def best_places(trials: Trials, context: Array, seed: int) -> Array:
    """Return the places with the greatest expected reward in a context, shape (p,)."""
    posterior, candidates = _model(trials, context, stream(seed, "best", len(trials.rewards)))
    return np.asarray(candidates[posterior.mean(candidates)[:, 0].argmax(), len(context) :])


def _model(trials: Trials, context: Array, random: np.random.Generator) -> tuple[Posterior, Array]:
    """Return the posterior of the reward, and candidates for a context: anywhere, and near the best trial."""
    size = trials.places.shape[1]
    best, steps = trials.places[trials.rewards.argmax()], random.standard_normal((len(NEARBY_SD), NEARBY, size))
    near = np.clip(best + np.reshape(NEARBY_SD, (-1, 1, 1)) * steps, -1.0, 1.0).reshape(-1, size)
    places = np.concatenate([random.uniform(-1.0, 1.0, (ANYWHERE, size)), near])
    candidates = np.concatenate([np.tile(context, (len(places), 1)), places], axis=1)
    return Posterior.fit(trials.points, trials.rewards[:, None], CENTRES), candidates
