"""Tuning of a node's parameters: which ones, within which ranges, and what happens in a trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from rkhs_ros.base.settings import Settings, build, setting
from rkhs_ros.base.validation import hint, require
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.sensors import Sensors
from rkhs_ros.robot.task import Reward, sensors_from

SCALES = ("linear", "log")


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

    def value(self, place: float) -> float:
        """Return the value at a place of the range, from -1 to 1."""
        share = 0.5 * (1.0 + min(max(place, -1.0), 1.0))
        if self.scale == "log":
            return float(self.minimum * (self.maximum / self.minimum) ** share)
        return self.minimum + share * (self.maximum - self.minimum)


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
    """The tuning of the parameters of one node.

    Attributes:
        parameters: the range of each parameter by its name.
        sensors: the sensors that a trial records.
    """

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

    def values(self, places: Sequence[float] | Array) -> dict[str, float]:
        """Return the values at the places in their ranges, each from -1 to 1."""
        return {name: each.value(place) for (name, each), place in zip(self.parameters.items(), places, strict=True)}

    def context_columns(self) -> list[int]:
        """Return the columns of an observation that are the context."""
        return [self.sensors.names.index(name) for name in self.context]


def tuning_from(tree: Mapping[str, Any]) -> Tuning:
    """Return the tuning of a configuration.

    Raises:
        ValueError: an unknown key, an invalid value, or a function that cannot be imported.
    """
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
    parameters = {str(name): _parameter(str(name), section) for name, section in ranges.items()}
    _ = tuning.reward.rule  # raises if it cannot be imported
    return replace(tuning, parameters=parameters, sensors=sensors)


def _parameter(name: str, section: Any) -> Parameter:
    try:
        return build(Parameter, section, f"parameters.{name}.")
    except ValueError as error:
        text = str(error)
        raise ValueError(text if f"parameters.{name}" in text else f"parameters.{name}: {text}") from error
