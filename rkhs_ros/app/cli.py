"""The command line ``rkhs``: a table of commands, each a module of this package, imported only when it is called."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from rkhs_ros import __version__
from rkhs_ros.base.endings import INTERRUPTED, RunError, print_error
from rkhs_ros.base.streams import messages_may_be_lost, readers_may_leave

# Each module has add_arguments(parser), and run(options), which returns the exit code.
COMMANDS = {
    "train": "learn a policy, or one for each of several seeds",
    "imitate": "fit a policy to what was shown",
    "evaluate": "measure a policy without exploration",
    "render": "film an episode without exploration",
    "plot": "draw the pictures of a run",
    "view": "show a run in the browser, while it learns or afterwards",
    "offline": "train on recordings alone",
    "replay": "make the updates of a recording again, and compare the bits",
    "export": "write recorded episodes as a LeRobotDataset",
    "compare": "draw the learning curves of several runs, with a table",
    "sweep": "learn at each point of a grid of settings, from several seeds",
    "tune": "search for settings that learn well",
    "reproduce": "make the paper's figures again",
    "results": "say which of the paper's claims hold, from reproduced figures",
    "simulate": "run a task's simulators, or a robot's nodes, for learners of other libraries",
    "serve": "have a function of one's own act in a simulator or on a robot",
    "status": "show what the nodes of a run report",
    "robot": "tell the nodes of a robot what a person decides: arm, stop, start, pause, veto",
    "list": "name the tasks, algorithms, kernels and figures",
}


class Parser(argparse.ArgumentParser):
    """Parses arguments, and refuses them in one line."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.register("type", Path, _path)

    def error(self, message: str) -> NoReturn:
        """Raise ValueError."""
        raise ValueError(f"{message} (see '{self.prog} --help')")


def _path(word: str) -> Path:
    """Return an argument as a path; an empty one, for example of an unset variable, would mean the current folder.

    Raises:
        ArgumentTypeError: it is empty.
    """
    if not word:
        raise argparse.ArgumentTypeError("expected a path, got an empty text")
    return Path(word)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; bad input ends with one line and exit code 2, what fails with one and exit code 1."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: what was learnt is kept
    with messages_may_be_lost():
        sys.exit(_exit_code(sys.argv[1:] if arguments is None else arguments))


def _exit_code(arguments: Sequence[str]) -> int:
    try:
        with readers_may_leave():
            _check_encoding(arguments)
            options = _parser(_called(arguments)).parse_args(arguments)
            _check_settings(getattr(options, "set", None) or [])
            return int(options.run(options))
    except (ValueError, OSError, RunError) as error:
        return print_error(error)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED


def _check_encoding(arguments: Sequence[str]) -> None:
    """Raise ValueError where an argument, such as a path, is no text that files and nodes can hold."""
    for word in arguments:
        if not word.isascii() and word.encode(errors="replace") != word.encode(errors="surrogatepass"):
            raise ValueError(f"argument: expected text in UTF-8, got {word!a}")


def _check_settings(changes: Sequence[str]) -> None:
    """Raise ValueError if --set gives a setting twice, with different values."""
    given: dict[str, str] = {}
    for change in changes:
        name, _, value = (part.strip() for part in change.partition("="))
        if given.setdefault(name, value) != value:
            raise ValueError(f"--set: {name}: expected one value, got {given[name]!a} and {value!a}")


def _called(arguments: Sequence[str]) -> str | None:
    """Return the command, which is the first word that is no option; None where there is none.

    Raises:
        ValueError: there is no such command.
    """
    called = next((word for word in arguments if not word.startswith("-")), None)
    if called is not None and called not in COMMANDS:
        from rkhs_ros.base.validation import hint, truncated  # imports numpy, which --help shall not wait for

        raise ValueError(f"unknown command '{truncated(called)}', {hint(called, COMMANDS)}")
    return called


def _parser(called: str | None) -> Parser:
    """Return the parser of all commands, with the arguments of the one that is called."""
    parser = Parser(prog="rkhs", description="Policy search in reproducing kernel Hilbert spaces.")
    parser.add_argument("--version", action="version", version=f"rkhs_ros {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, about in COMMANDS.items():
        command = commands.add_parser(name, help=about, description=f"{about[0].upper()}{about[1:]}.")
        if name == called:
            module = import_module(f"rkhs_ros.app.commands.{name}")
            module.add_arguments(command)
            command.set_defaults(run=module.run)
    return parser


if __name__ == "__main__":
    main()
