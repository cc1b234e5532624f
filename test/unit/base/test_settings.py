from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import pytest

from rkhs_ros.base.settings import build, entries, setting
from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC
from rkhs_ros.learning.algorithms.rkhs_power import RKHSPoWER
from rkhs_ros.learning.algorithms.step_rules import FixedStep
from rkhs_ros.learning.kernel_choice import KernelChoice
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.rkhs.kernels import Sum


@dataclass(frozen=True)
class Inner:
    rate: float = setting(0.5, "a rate", minimum=0.0, maximum=1.0)


@dataclass(frozen=True)
class Outer:
    count: int = setting(3, "a count", minimum=1, maximum=9)
    label: str = setting("a", "a label", choices=("a", "bee"))
    widths: tuple[float, ...] = setting((1.0,), "widths", minimum=0.0)
    either: str | tuple[float, ...] = setting("auto", "a word or numbers", minimum=0.0, choices=("auto",))
    inner: Inner = field(default_factory=Inner)


@pytest.mark.parametrize(
    ("tree", "expected"),
    [
        ({"inner": {"rate": 1}}, 1.0),
        ({"widths": [2, 3]}, (2.0, 3.0)),
        ({"widths": 2}, (2.0,)),
        ({"either": 4}, (4.0,)),
        ({"either": [4, 5]}, (4.0, 5.0)),
        ({"either": "auto"}, "auto"),
    ],
)
def test_build_converts_whole_numbers_to_floats(tree: dict[str, Any], expected: object) -> None:
    made = build(Outer, tree)
    got = made.inner.rate if "inner" in tree else getattr(made, next(iter(tree)))
    assert got == expected
    assert type(got) is type(expected)
    if isinstance(got, tuple):
        assert all(type(number) is float for number in got)


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        ({"coumt": 1}, r"^unknown key 'coumt', did you mean 'count'\?$"),
        ({"zzz": 1}, r"^unknown key 'zzz', known: count, either, inner, label, widths$"),
        ({"inner": {"rat": 1}}, r"^unknown key 'inner\.rat', did you mean 'inner\.rate'\?$"),
        ({"count": 2.0}, r"^count: expected a whole number, got 2\.0$"),
        ({"count": 0}, r"^count: expected a number in \[1, 9\], got 0$"),
        ({"inner": {"rate": "x"}}, r"^inner\.rate: expected a number, got 'x'$"),
        ({"inner": 3}, r"^inner: expected a section of keys, got 3$"),
        ({"label": "be"}, r"^label: unknown choice 'be', did you mean 'bee'\?$"),
        ({"widths": [1.0, "x"]}, r"^widths: expected a list of numbers"),
        ({"widths": [1.0, -2.0]}, r"^widths: expected a number in \[0\.0, inf\], got -2\.0$"),
    ],
)
def test_invalid_values_raise_one_line_errors(tree: dict[Any, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        build(Outer, tree)
    assert "\n" not in str(refusal.value)


def test_a_variant_is_built_by_name_with_its_settings() -> None:
    training = build(Training, {"algorithm": {"name": "rkhs_nac", "step": {"rule": "fixed", "size": 1}}})
    assert training.algorithm == RKHSNAC(step=FixedStep(1.0))
    assert build(Training, {"algorithm": {"name": "rkhs_power", "centres": 7}}).algorithm == RKHSPoWER(centres=7)
    assert build(Training, {"algorithm": {"centres": 7}}).algorithm == RKHSNAC(centres=7)


def leaves(value: Any, path: str = "") -> set[str]:
    if not is_dataclass(value):
        return {path.rstrip(".")}
    own: set[str] = set()
    for f in fields(value):
        child = getattr(value, f.name)
        if not (f.metadata or is_dataclass(child)):  # not a setting
            continue
        if "key" in f.metadata:
            own.add(f"{path}{f.name}.{f.metadata['key']}")
        own |= leaves(child, f"{path}{f.name}.")
    return own


@pytest.mark.parametrize(
    "training",
    [
        Training(),
        Training(algorithm=RKHSPoWER(), kernel=KernelChoice("rbf")),
        Training(algorithm=RKHSNAC(step=FixedStep())),
    ],
    ids=["default", "power", "fixed step"],
)
def test_entries_list_every_setting_once_with_its_description(training: Training) -> None:
    listed = list(entries(training))
    names = [entry.name for entry in listed]
    assert len(names) == len(set(names))
    assert set(names) == leaves(training)
    assert all(entry.about["description"] for entry in listed)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Training(iterations=-3), r"^iterations: expected a number in \[1, 1000000\], got -3$"),
        (lambda: Training(algorithm="rkhs_nac"), "^algorithm: expected Algorithm, got 'rkhs_nac'$"),
        (lambda: RKHSNAC(critic="stepp"), r"^critic: unknown choice 'stepp', did you mean 'step'\?$"),
        (lambda: RKHSPoWER(sd_range=(5.0, 4.0)), r"sd_range: expected a minimum and a maximum, got \(5\.0, 4\.0\)$"),
        (lambda: KernelChoice(bandwidth=0.0), r"^bandwidth: expected a number in \[1e-09, 1000000000\.0\], got 0\.0$"),
    ],
)
def test_settings_created_in_python_are_checked(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("cls", [Training, RKHSNAC, Sum])
def test_an_unknown_keyword_suggests_the_closest_setting(cls: type) -> None:
    for f in fields(cls):
        with pytest.raises(TypeError, match=rf"^{cls.__name__}: unknown setting '{f.name}x', did you mean '{f.name}'"):
            cls(**{f.name + "x": 1})
