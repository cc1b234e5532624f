"""Command line ``rkhs``: a table of commands, each in a module that is imported only when it is called."""

import argparse
import os
import signal
import sys
from collections.abc import Collection, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from rkhs_ros import __version__
from rkhs_ros.app.named import path
from rkhs_ros.base.endings import INTERRUPTED, RunError, print_error, tolerate_closed_stdout, tolerate_lost_stderr

# Each module defines add_arguments(parser) and run(options), which returns the exit code.
COMMANDS = {
    "check": "explore a task and print what its settings should be",
    "train": "train a policy, or one policy for each of several seeds",
    "imitate": "fit a policy to demonstrations",
    "evaluate": "measure the return of a policy without exploration noise",
    "render": "render an episode of a policy as pictures and an animation",
    "plot": "plot the learning curve and the policy of a run",
    "view": "show a run in the browser, live or afterwards",
    "offline": "train a policy from recordings alone",
    "replay": "recompute the updates of a recording and check that they are bit-identical",
    "export": "export a policy for use without rkhs_ros, or recorded episodes as a LeRobotDataset",
    "compare": "plot and tabulate the learning curves of several runs",
    "sweep": "train at each point of a grid of settings, with several seeds",
    "reproduce": "reproduce the figures of the paper",
    "simulate": "run a simulator, or the nodes of a robot, for learners of other libraries",
    "status": "show the status of the nodes of a run",
    "robot": "send an operator command to the nodes of a robot: arm, stop, start, pause or veto",
    "tune-node": "tune the parameters of a ROS 2 node in a few dozen trials",
    "list": "list the tasks, algorithms, kernels and figures",
}


class Parser(argparse.ArgumentParser):
    """Argument parser that reports errors in one line."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.register("type", Path, path)

    def error(self, message: str) -> NoReturn:
        """Raise ValueError."""
        raise ValueError(f"{message} (see '{self.prog} --help')")


# Linear algebra uses one thread, also in nodes and workers, which inherit this; numpy is not imported yet.
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line: print one line and exit with code 2 for bad input, 1 for a failure."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # like Ctrl-C: the run saves its policy
    os.environ.update(ONE_THREAD)
    if "_ARGCOMPLETE" in os.environ:
        _complete(os.environ["COMP_LINE"])
    with tolerate_lost_stderr():
        sys.exit(_exit_code(sys.argv[1:] if arguments is None else arguments))


def _complete(line: str) -> None:
    """Pass the completions of a command line to the shell that requests them, and exit."""
    import argcomplete  # only here, since few calls need it

    argcomplete.autocomplete(parser_of(line.split()))


def _exit_code(arguments: Sequence[str]) -> int:
    try:
        with tolerate_closed_stdout():
            _check_encoding(arguments)
            options = _parsed(list(arguments))
            _check_settings(getattr(options, "set", None) or [])
            return int(options.run(options))
    except (ValueError, OSError, RunError) as error:
        return print_error(error)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED


def _parsed(arguments: list[str]) -> argparse.Namespace:
    called = _called(arguments)
    if not called or arguments[0] != called[0]:  # --help or --version
        return parser_of(called).parse_args(arguments)
    command = Parser(prog=f"rkhs {called[0]}", description=_description(called[0]))
    _fill(command, called[0])
    return command.parse_intermixed_args(arguments[1:])  # options may stand between files


def _check_encoding(arguments: Sequence[str]) -> None:
    """Raise ValueError if an argument, such as a path, cannot be encoded as UTF-8, as files and nodes require."""
    for word in arguments:
        if not word.isascii() and word.encode(errors="replace") != word.encode(errors="surrogatepass"):
            raise ValueError(f"argument: expected text in UTF-8, got {word!a}")


def _check_settings(changes: Sequence[str]) -> None:
    """Raise ValueError if --set gives a setting two different values."""
    given: dict[str, str] = {}
    for change in changes:
        name, _, value = (part.strip() for part in change.partition("="))
        if given.setdefault(name, value) != value:
            raise ValueError(f"--set: {name}: expected one value, got {given[name]!a} and {value!a}")


def _called(arguments: Sequence[str]) -> list[str]:
    """Return the command, which is the first word that is not an option, as a list; it is empty if there is none.

    Raises:
        ValueError: the command is unknown.
    """
    called = [word for word in arguments if not word.startswith("-")][:1]
    if not COMMANDS.keys() >= {*called}:
        from rkhs_ros.base.validation import hint, truncated  # imports numpy, which would slow down --help

        raise ValueError(f"unknown command '{truncated(called[0])}', {hint(called[0], COMMANDS)}")
    return called


def parser_of(called: Collection[str]) -> Parser:
    """Return the parser of all commands, with the arguments of the called commands only, whose modules it imports."""
    parser = Parser(prog="rkhs", description="Policy search in reproducing kernel Hilbert spaces.")
    parser.add_argument("--version", action="version", version=f"rkhs_ros {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, about in COMMANDS.items():
        command = commands.add_parser(name, help=about, description=_description(name))
        if name in called:
            _fill(command, name)
    return parser


def _description(name: str) -> str:
    return f"{COMMANDS[name][0].upper()}{COMMANDS[name][1:]}."


def _fill(parser: Parser, name: str) -> None:
    """Add the arguments of a command."""
    module = import_module(f"rkhs_ros.app.commands.{name.replace('-', '_')}")
    module.add_arguments(parser)
    parser.set_defaults(run=module.run)


if __name__ == "__main__":
    main()
