"""The settings of a gate, and the rules derived from them."""

from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from rkhs_ros.base.settings import Settings, setting
from rkhs_ros.base.validation import numbers, require
from rkhs_ros.rkhs.kernels import Array
from rkhs_ros.robot.gate_state import Rules
from rkhs_ros.robot.limits import EFFORT, KINDS, LIMITS, MOST, POSITION, SENSED_LIMITS, VELOCITY, Limits, SensedLimits
from rkhs_ros.robot.urdf import located, read_limits

FLOAT, FLOATS = "std_msgs/msg/Float64", "std_msgs/msg/Float64MultiArray"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
KINDS_OF = {FLOATS: KINDS, FLOAT: KINDS, TRAJECTORY: (POSITION,), TWIST: (VELOCITY,), TWIST_STAMPED: (VELOCITY,)}
AXES = tuple(f"{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")  # the "joints" of a Twist
Numbers = tuple[float, ...]
LONGEST_END_S = 8.0  # longest time for a robot to come to rest before its gate exits; others wait longer


@dataclass(frozen=True)
class SensorSettings(Settings):
    """The source of the joint states."""

    topic: str = setting(
        "joint_states", "topic of sensor_msgs/JointState; empty for none, for velocity commands only, such as a Twist"
    )


@dataclass(frozen=True)
class CommandSettings(Settings):
    """The destination of the commands."""

    topic: str = setting("", "topic on which the hardware receives commands")
    type: str = setting(FLOATS, "type of its messages", choices=tuple(KINDS_OF))
    kind: str = setting("", "quantity that the commands set", choices=("", *KINDS))
    frame: str = setting("base_link", "frame of a TwistStamped")


def _magnitudes(description: str) -> Numbers:
    return setting((), description, minimum=0.0, maximum=MOST)  # type: ignore[no-any-return]


def _places(description: str) -> Numbers:
    return setting((), description, minimum=-MOST, maximum=MOST)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class LimitSettings(Settings):
    """Limits of the commands. 0 is a limit; an omitted limit means no limit."""

    urdf: str = setting(
        "",
        "URDF to read limits from, FILE or package://PACKAGE/FILE; the settings below may tighten them; empty for none",
    )
    minimum: Numbers = _places("least command of each joint, in its unit")
    maximum: Numbers = _places("greatest command of each joint, in its unit")
    velocity: Numbers = _magnitudes("positions and efforts: greatest change per second; velocities: greatest magnitude")
    acceleration: Numbers = _magnitudes("greatest change of the velocity per second; none for efforts")
    step: Numbers = _magnitudes("greatest difference of successive commands, in their unit")


@dataclass(frozen=True)
class SensedSettings(Settings):
    """Limits of the sensed joint states; exceeding one stops the robot."""

    minimum: Numbers = _places("least position of each joint, rad or m")
    maximum: Numbers = _places("greatest position of each joint, rad or m")
    velocity: Numbers = _magnitudes("greatest velocity of each joint, rad/s or m/s")
    effort: Numbers = _magnitudes("greatest effort of each joint, N m or N")


@dataclass(frozen=True)
class HoldSettings(Settings):
    """Gains with which effort-controlled joints hold their position."""

    stiffness: Numbers = _magnitudes("spring of each joint, N m/rad or N/m; for efforts only")
    damping: Numbers = _magnitudes("damper of each joint, N m s/rad or N s/m; for efforts only")


@dataclass(frozen=True)
class RestSettings(Settings):
    """When a robot counts as being at rest, so that its gate may exit."""

    speed: float = setting(
        0.02, "greatest speed of joints at rest, rad/s or m/s; for efforts only", minimum=0.0, maximum=MOST
    )
    time: float = setting(0.2, "seconds for which the robot must stay at rest", minimum=0.0, maximum=5.0)
    timeout: float = setting(
        3.0, "seconds after which the gate exits even if the robot is not at rest", minimum=0.0, maximum=LONGEST_END_S
    )


@dataclass(frozen=True)
class GateSettings(Settings):
    """The settings of a gate."""

    joints: tuple[str, ...] = setting((), "names of the joints, in the order of the commands; the axes of a Twist")
    sensor: SensorSettings = SensorSettings()
    command: CommandSettings = CommandSettings()
    limits: LimitSettings = LimitSettings()
    sensed: SensedSettings = SensedSettings()
    hold: HoldSettings = HoldSettings()
    rest: RestSettings = RestSettings()
    command_timeout: float = setting(
        0.2, "seconds without a command after which the gate stops a motion", minimum=0.001, maximum=60.0
    )
    stop_topics: tuple[str, ...] = setting(
        ("stop",), "topics of std_msgs/Bool on which other nodes request a stop, with one publisher each"
    )
    stop_timeout: Numbers = setting(
        (0.0,),
        "seconds without a message on a stop topic after which the gate stops, one or one per topic; 0 for no timeout",
        minimum=0.0,
        maximum=60.0,
    )
    arms_itself: bool = setting(
        False,
        "arm without a person while only simulated robots subscribe to the command topic, by the names of the nodes",
    )
    stale_after: float = setting(0.1, "seconds after which a sensed state is stale", minimum=0.001, maximum=60.0)
    period: float = setting(0.01, "seconds between messages to the hardware", minimum=0.001, maximum=1.0)

    def __post_init__(self) -> None:
        """Raise ValueError if settings are missing or inconsistent."""
        super().__post_init__()
        topics = self.stop_topics
        require(len(set(topics)) == len(topics), "stop_topics", "unique names", ", ".join(topics))
        sizes = (1, len(topics))
        require(len(self.stop_timeout) in sizes, "stop_timeout", numbers(*sizes), len(self.stop_timeout))
        if not self.joints:
            return  # the defaults, which `rules` refuses
        require(len(set(self.joints)) == len(self.joints), "joints", "unique names", ", ".join(self.joints))
        kinds = KINDS_OF[self.command.type]
        require(self.command.kind in kinds, "command.kind", " or ".join(kinds), f"'{self.command.kind}'")
        if self.command.type == FLOAT:
            require(len(self.joints) == 1, "joints", f"1 name for {FLOAT}", len(self.joints))
        if self.command.type in (TWIST, TWIST_STAMPED):
            require(set(self.joints) <= set(AXES), "joints", f"some of {', '.join(AXES)}", ", ".join(self.joints))
            require(not self.sensor.topic, "sensor.topic", "'' for a Twist, which has no joints", self.sensor.topic)

    def stop_timeouts(self) -> dict[str, float]:
        """Return the timeout of each stop topic, in seconds; 0 for none."""
        timeouts = self.stop_timeout * len(self.stop_topics) if len(self.stop_timeout) == 1 else self.stop_timeout
        return dict(zip(self.stop_topics, timeouts, strict=True))


def rules(settings: GateSettings) -> Rules:
    """Return the rules of a gate with these settings.

    Raises:
        ValueError: limits are missing, contradictory or wider than the URDF's, or their number is not that of the
            joints.
        OSError: the URDF cannot be read.
    """
    require(bool(settings.joints), "joints", "the names of the joints", "none")
    require(bool(settings.command.topic), "command.topic", "the topic on which the hardware receives commands", "none")
    commands, sensed = _urdf_limits(settings)
    return Rules(
        Limits(
            settings.command.kind,
            **{name: _tightest(settings, f"limits.{name}", commands.get(name)) for name in LIMITS},
        ),
        SensedLimits(**{name: _tightest(settings, f"sensed.{name}", sensed.get(name)) for name in SENSED_LIMITS}),
        _gains(settings, "hold.stiffness"),
        _gains(settings, "hold.damping"),
        settings.command_timeout,
        settings.stale_after if settings.sensor.topic else np.inf,
        settings.period,
        settings.rest.speed,
        settings.rest.time,
    )


def _urdf_limits(settings: GateSettings) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the URDF's limits of commands, and those of sensed states that do not bound the commands themselves."""
    if not settings.limits.urdf:
        return {}, {}
    lower, upper, velocity, effort = read_limits(located(settings.limits.urdf), settings.joints)
    positions = {"minimum": lower, "maximum": upper}
    match settings.command.kind:
        case "position":
            return positions | {"velocity": velocity}, {}
        case "velocity":
            return {"minimum": -velocity, "maximum": velocity}, positions if settings.sensor.topic else {}
        case _:
            return {"minimum": -effort, "maximum": effort}, positions | {"velocity": velocity}


def _tightest(settings: GateSettings, name: str, urdf: Array | None) -> Array:
    """Return a limit for each joint, from the settings, else from the URDF, else infinity."""
    given, sign = attrgetter(name)(settings), -1.0 if name.endswith("minimum") else 1.0
    widest = np.full(len(settings.joints), sign * np.inf) if urdf is None else urdf
    if not given:
        return widest
    values = _for_each(settings, name)
    good = bool((sign * values <= sign * widest).all())
    require(good, name, f"limits no wider than the URDF's, {widest}", values)
    return values


def _gains(settings: GateSettings, name: str) -> Array:
    """Return the gains of joints that hold by effort, which are required; zeros for other commands."""
    given, is_effort = attrgetter(name)(settings), settings.command.kind == EFFORT
    expected = "gains (required for effort commands)" if is_effort else "none (used for effort commands only)"
    require(bool(given) == is_effort, name, expected, given)
    return _for_each(settings, name) if given else np.zeros(len(settings.joints))


def _for_each(settings: GateSettings, name: str) -> Array:
    """Return a number for each joint; a single one is broadcast."""
    given, joints = attrgetter(name)(settings), len(settings.joints)
    require(len(given) in (1, joints), name, numbers(1, joints), len(given))
    return np.broadcast_to(given, joints).astype(np.float64)
