"""The settings of a gate, and the rules that follow from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import numbers, require
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_state import Rules
from rkhs_ros.robot.limits import EFFORT, KINDS, MOST, POSITION, VELOCITY, Limits, SensedLimits
from rkhs_ros.robot.urdf import JointLimit, located, read_limits

FLOATS, TRAJECTORY = "std_msgs/msg/Float64MultiArray", "trajectory_msgs/msg/JointTrajectory"
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
KINDS_OF = {FLOATS: KINDS, TRAJECTORY: (POSITION,), TWIST: (VELOCITY,), TWIST_STAMPED: (VELOCITY,)}
AXES = tuple(f"{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")  # what a Twist has for joints
Numbers = tuple[float, ...]
OWN_TOPICS = ("command", "stop", "robot/obstacle", "gate/report", "gate/state")  # of every gate
LONGEST_END_S = 8.0  # for a robot to come to rest before its gate ends; a launcher waits for as long


@dataclass(frozen=True)
class SensorSettings(Settings):
    """Where the joints are sensed."""

    topic: str = setting(
        "joint_states", "topic of sensor_msgs/JointState; empty for none, of velocities only, as of a Twist"
    )


@dataclass(frozen=True)
class CommandSettings(Settings):
    """Where commands go."""

    topic: str = setting("", "topic of the hardware that takes the commands")
    type: str = setting(FLOATS, "type of its messages", choices=tuple(KINDS_OF))
    kind: str = setting("", "what the commands are", choices=("", *KINDS))
    frame: str = setting("base_link", "frame of a TwistStamped")


def _magnitudes(description: str) -> Numbers:
    return setting((), description, minimum=0.0, maximum=MOST)  # type: ignore[no-any-return]


def _places(description: str) -> Numbers:
    return setting((), description, minimum=-MOST, maximum=MOST)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class LimitSettings(Settings):
    """Limits of the commands; 0 is a limit, and one that is not given there is none of."""

    urdf: str = setting(
        "",
        "URDF to take limits from, FILE or package://PACKAGE/FILE; those below may tighten them; empty for none",
    )
    minimum: Numbers = _places("least command of each joint, in its unit")
    maximum: Numbers = _places("greatest command of each joint, in its unit")
    velocity: Numbers = _magnitudes(
        "of positions and efforts the greatest change per second, of velocities the greatest"
    )
    acceleration: Numbers = _magnitudes("greatest change per second of the velocity; none of efforts")
    step: Numbers = _magnitudes("how far a command may be from the one before, in its unit")


@dataclass(frozen=True)
class SensedSettings(Settings):
    """Limits of what is sensed; passing one stops the robot."""

    minimum: Numbers = _places("least position of each joint, rad or m")
    maximum: Numbers = _places("greatest position of each joint, rad or m")
    velocity: Numbers = _magnitudes("greatest velocity of each joint, rad/s or m/s")
    effort: Numbers = _magnitudes("greatest effort of each joint, N m or N")


@dataclass(frozen=True)
class HoldSettings(Settings):
    """How joints that are commanded by effort hold."""

    stiffness: Numbers = _magnitudes("spring of each joint, N m/rad or N/m; of efforts only")
    damping: Numbers = _magnitudes("damper of each joint, N m s/rad or N s/m; of efforts only")


@dataclass(frozen=True)
class RestSettings(Settings):
    """When a robot is at rest, before its gate ends."""

    speed: float = setting(
        0.02, "greatest speed of joints at rest, rad/s or m/s; of efforts only", minimum=0.0, maximum=MOST
    )
    time: float = setting(0.2, "seconds for which the robot must be at rest without a break", minimum=0.0, maximum=5.0)
    timeout: float = setting(
        3.0, "seconds after which the gate ends though the robot is not at rest", minimum=0.0, maximum=LONGEST_END_S
    )


@dataclass(frozen=True)
class GateSettings(Settings):
    """The settings of a gate."""

    joints: tuple[str, ...] = setting((), "names of the joints, in the order of commands; of a Twist its axes")
    sensor: SensorSettings = SensorSettings()
    command: CommandSettings = CommandSettings()
    limits: LimitSettings = LimitSettings()
    sensed: SensedSettings = SensedSettings()
    hold: HoldSettings = HoldSettings()
    rest: RestSettings = RestSettings()
    command_timeout: float = setting(
        0.2, "seconds without a command after which a motion is stopped", minimum=0.001, maximum=60.0
    )
    stop_timeout: float = setting(
        0.0, "seconds of silence of a publisher of 'stop' that mean stop; 0 for none", minimum=0.0, maximum=60.0
    )
    stale_after: float = setting(0.1, "age in seconds at which what was sensed is too old", minimum=0.001, maximum=60.0)
    period: float = setting(0.01, "seconds between messages to the hardware", minimum=0.001, maximum=1.0)

    def __post_init__(self) -> None:
        """Raise ValueError where settings are missing or do not fit each other."""
        super().__post_init__()
        if not self.joints:
            return  # the defaults, of which a node cannot do: see `rules`
        require(len(set(self.joints)) == len(self.joints), "joints", "names that differ", ", ".join(self.joints))
        kinds = KINDS_OF[self.command.type]
        require(self.command.kind in kinds, "command.kind", " or ".join(kinds), f"'{self.command.kind}'")
        if self.command.type in (TWIST, TWIST_STAMPED):
            require(set(self.joints) <= set(AXES), "joints", f"of {', '.join(AXES)}", ", ".join(self.joints))
            require(not self.sensor.topic, "sensor.topic", "none for a Twist, which has no joints", self.sensor.topic)


def rules(settings: GateSettings) -> Rules:
    """Return what a gate goes by.

    Raises:
        ValueError: limits are missing, cross each other, are wider than the URDF's, or are not as many as joints.
        OSError: the URDF cannot be read.
    """
    require(bool(settings.joints), "joints", "the names of the joints", "none")
    require(bool(settings.command.topic), "command.topic", "the topic that takes the commands", "none")
    require_own_topic(settings, str)
    limits = read_limits(located(settings.limits.urdf), settings.joints) if settings.limits.urdf else []
    return Rules(
        _limits(settings, limits),
        _sensed_limits(settings, limits),
        _gains(settings, "stiffness"),
        _gains(settings, "damping"),
        settings.command_timeout,
        settings.stale_after if settings.sensor.topic else np.inf,
        settings.period,
        settings.rest.speed,
        settings.rest.time,
    )


def require_own_topic(settings: GateSettings, resolved: Callable[[str], str]) -> None:
    """Check that the hardware has a topic of its own: a gate must not hear its own commands.

    Args:
        settings: of the gate.
        resolved: returns the full name of a topic.

    Raises:
        ValueError: the gate uses the topic for something else.
    """
    topic, others = settings.command.topic, [*OWN_TOPICS, settings.sensor.topic]
    taken = {resolved(name) for name in others if name}
    expected = "a topic that the gate does not use otherwise"
    require(resolved(topic) not in taken, "command.topic", expected, topic)


def _limits(settings: GateSettings, urdf: Sequence[JointLimit]) -> Limits:
    """Return the limits of commands, of which a URDF may tell some."""
    told: dict[str, list[float]] = {}
    if settings.command.kind == POSITION:
        told = {
            "minimum": [joint.lower for joint in urdf],
            "maximum": [joint.upper for joint in urdf],
            "velocity": [joint.velocity for joint in urdf],
        }
    else:
        most = [joint.velocity if settings.command.kind == VELOCITY else joint.effort for joint in urdf]
        told = {"minimum": [-limit for limit in most], "maximum": most}
    values = {
        name: _tightest(getattr(settings.limits, name), told.get(name, []), settings, f"limits.{name}")
        for name in ("minimum", "maximum", "velocity", "acceleration", "step")
    }
    return Limits(settings.command.kind, **values)


def _sensed_limits(settings: GateSettings, urdf: Sequence[JointLimit]) -> SensedLimits:
    """Return the limits of what is sensed; a URDF tells those that commands are not bounded by."""
    told: dict[str, list[float]] = {}
    if settings.command.kind != POSITION and settings.sensor.topic:
        told = {"minimum": [joint.lower for joint in urdf], "maximum": [joint.upper for joint in urdf]}
    if settings.command.kind == EFFORT:
        told["velocity"] = [joint.velocity for joint in urdf]
    values = {
        name: _tightest(getattr(settings.sensed, name), told.get(name, []), settings, f"sensed.{name}")
        for name in ("minimum", "maximum", "velocity", "effort")
    }
    return SensedLimits(**values)


def _tightest(given: Numbers, told: Sequence[float], settings: GateSettings, name: str) -> Array:
    """Return a limit for each joint, as given or else as the URDF tells; infinity where neither does.

    Raises:
        ValueError: there are not as many as joints, or what is given is wider than what the URDF tells.
    """
    sign = -1.0 if name.endswith("minimum") else 1.0
    widest = np.array(told) if told else np.full(len(settings.joints), sign * np.inf)
    if not given:
        return widest
    values = _for_each(given, settings, name)
    good = bool((sign * values <= sign * widest).all())
    require(good, name, f"limits no wider than the URDF's, {widest}", values)
    return values


def _for_each(given: Numbers, settings: GateSettings, name: str) -> Array:
    """Return a number for each joint, where one may stand for all."""
    joints = len(settings.joints)
    require(len(given) in (1, joints), name, numbers(1, joints), len(given))
    return np.broadcast_to(given, joints).astype(np.float64)


def _gains(settings: GateSettings, name: str) -> Array:
    """Return the gains of joints that hold by effort; of others there are none.

    Raises:
        ValueError: they are missing or there are too many, or some that are of no use.
    """
    given, is_effort = getattr(settings.hold, name), settings.command.kind == EFFORT
    require(bool(given) == is_effort, f"hold.{name}", "gains of joints commanded by effort, and of no others", given)
    return _for_each(given, settings, f"hold.{name}") if given else np.zeros(len(settings.joints))
