"""Policy search in reproducing kernel Hilbert spaces, as a library and as a ROS 2 learning system.

The package imports a public name when it is first used: `train` and `learn` for any Gymnasium environment, `evaluate`
and `compare` for their results, `load` for a trained `Policy`, `load_model` for the dynamics model of a run, the
algorithms and step rules, model-based training, the kernels, and the policy inputs (`Inputs`).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from rkhs_ros.app.library import Result as Result, learn as learn, train as train
    from rkhs_ros.app.measure import evaluate as evaluate, load_model as load_model
    from rkhs_ros.base.endings import RunError as RunError
    from rkhs_ros.learning.algorithms.ac import AC as AC
    from rkhs_ros.learning.algorithms.enac import ENAC as ENAC
    from rkhs_ros.learning.algorithms.power import PoWER as PoWER
    from rkhs_ros.learning.algorithms.rkhs_ac import RKHSAC as RKHSAC
    from rkhs_ros.learning.algorithms.rkhs_nac import RKHSNAC as RKHSNAC
    from rkhs_ros.learning.algorithms.rkhs_npg import RKHSNPG as RKHSNPG
    from rkhs_ros.learning.algorithms.rkhs_power import RKHSPoWER as RKHSPoWER
    from rkhs_ros.learning.algorithms.step_rules import (
        FixedStep as FixedStep,
        KLStep as KLStep,
        LineSearch as LineSearch,
    )
    from rkhs_ros.learning.kernel_choice import KernelChoice as KernelChoice
    from rkhs_ros.learning.training_settings import ModelBased as ModelBased, NoModel as NoModel
    from rkhs_ros.policies.inputs import Inputs as Inputs
    from rkhs_ros.policies.policy import Policy as Policy, load as load
    from rkhs_ros.rkhs.kernels import RBF as RBF, Linear as Linear, Polynomial as Polynomial
    from rkhs_ros.rollouts.evaluation import Evaluation as Evaluation
    from rkhs_ros.studies.comparison import Comparison as Comparison, compare as compare

_HOMES = {
    "app.library": ("Result", "learn", "train"),
    "app.measure": ("evaluate", "load_model"),
    "base.endings": ("RunError",),
    "learning.algorithms.registry": ("AC", "ENAC", "PoWER", "RKHSAC", "RKHSNAC", "RKHSNPG", "RKHSPoWER"),
    "learning.kernel_choice": ("KernelChoice",),
    "learning.training_settings": ("ModelBased", "NoModel"),
    "learning.algorithms.step_rules": ("FixedStep", "KLStep", "LineSearch"),
    "policies.inputs": ("Inputs",),
    "policies.policy": ("Policy", "load"),
    "rkhs.kernels": ("RBF", "Linear", "Polynomial"),
    "rollouts.evaluation": ("Evaluation",),
    "studies.comparison": ("Comparison", "compare"),
}
_MODULES = {name: f"rkhs_ros.{module}" for module, names in _HOMES.items() for name in names}
__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    if name not in _MODULES:
        raise AttributeError(f"module 'rkhs_ros' has no attribute {name!r}, known: {', '.join(__all__)}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return [*__all__, "__version__"]
