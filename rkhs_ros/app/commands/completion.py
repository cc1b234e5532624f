"""``rkhs completion``: print a script with which a shell completes the command line.

The script contains all names, so that a completion starts no Python.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from string import Template
from typing import Any

import gymnasium

import rkhs_ros.app.inline  # noqa: F401  # registers the tasks
from rkhs_ros.app.cli import COMMANDS, parser_of
from rkhs_ros.base.validation import require_extra
from rkhs_ros.learning.algorithms.registry import ALGORITHMS
from rkhs_ros.learning.training_settings import Training
from rkhs_ros.paper.experiment import known

SHELLS = ("bash", "zsh")
COMPLETED_BY = {
    "CONFIG": "_rkhs_config_file",
    "ENV|CONFIG": "_rkhs_task_file",
    **dict.fromkeys(("DIR", "FOLDER"), "directory"),  # like "file" below, a name of shtab
    **dict.fromkeys(("FILE", "FILE.png", "POLICY", "DIR|FILE", "DIR|EPISODES", "RECORDING"), "file"),
    **dict.fromkeys(("KEY", "KEY=VALUE", "KEY=V,V"), "_rkhs_setting"),
}  # completion by the placeholder of an argument
FUNCTIONS = {
    "bash": """_rkhs_config_file() { compgen -d -- "$$1"; compgen -f -X '!*.yaml' -- "$$1"; }
_rkhs_task_file() { compgen -W '$tasks' -- "$$1"; _rkhs_config_file "$$1"; }
_rkhs_setting() { compgen -W '$settings' -- "$$1"; }""",
    "zsh": """_rkhs_config_file() { _files -g '*.yaml'; }
_rkhs_task_file() { compadd -- $tasks; _rkhs_config_file; }
_rkhs_setting() { compadd -S '' -- $settings; }""",
}
# In bash, only the function for the whole line can leave out the space after `KEY=`.
LAST = {
    "bash": """
_rkhs() { _shtab_rkhs "$@"; [[ "${COMPREPLY[0]-}" != *= ]] || compopt -o nospace 2>/dev/null || :; }
complete -o bashdefault -F _rkhs rkhs""",
    "zsh": "",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help="bash or zsh")


def run(options: argparse.Namespace) -> int:
    """Print the script."""
    require_extra("shtab", "completion", "completion")
    import shtab

    names = {"tasks": " ".join(gymnasium.registry), "settings": " ".join(dict.fromkeys(_settings(Training())))}
    functions = Template(FUNCTIONS[options.shell]).substitute(names)
    print(shtab.complete(_parser(), options.shell, preamble=functions) + LAST[options.shell])
    return 0


def _parser() -> argparse.ArgumentParser:
    """Return the parser of all commands, with completions for their arguments."""
    parser = parser_of(COMMANDS)
    choices = {"ID": list(gymnasium.registry), "NAME": list(ALGORITHMS), "FIGURE": [*known(), "all"]}
    (commands,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    for command in commands.choices.values():
        for action in command._actions:
            placeholder = str(action.metavar)  # None for options with choices
            if kind := COMPLETED_BY.get(placeholder):
                action.complete = dict.fromkeys(SHELLS, kind) if kind.startswith("_") else kind  # read by shtab
            else:
                action.choices = choices.get(placeholder, action.choices and list(action.choices))
    return parser


def _settings(settings: Any, path: str = "") -> Iterator[str]:
    """Yield the name of each setting of all choices, followed by ``=``; names may repeat."""
    for f in fields(settings):
        value = getattr(settings, f.name)
        if "table" in f.metadata:
            yield f"{path}{f.name}.{f.metadata['key']}="
            for choice in f.metadata["table"].values():
                yield from _settings(choice(), f"{path}{f.name}.")
        elif is_dataclass(value):
            yield from _settings(value, f"{path}{f.name}.")
        elif "description" in f.metadata:
            yield f"{path}{f.name}="
