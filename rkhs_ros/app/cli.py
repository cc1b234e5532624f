"""Command line ``rkhs``: a table of commands, whose modules are imported only when they are called."""

import argparse
import os
import re
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from rkhs_ros import __version__
from rkhs_ros.base.endings import INTERRUPTED, RunError, print_error
from rkhs_ros.base.processes import search_here

# Module and summary of each command; the module's function add_NAME(parser) declares the arguments, and run_NAME runs
# the command with the parsed arguments, and returns the exit code.
COMMANDS = {
    "check": ("tasks", "explore a task and print what its settings should be"),
    "train": ("train", "train a policy, or one policy for each of several seeds"),
    "imitate": ("recordings", "fit a policy to demonstrations"),
    "evaluate": ("policies", "measure the return of a policy without exploration noise"),
    "render": ("policies", "render an episode of a policy as pictures and an animation"),
    "plot": ("policies", "plot the learning curve and the policy of a run"),
    "view": ("view", "show a run in the browser, live or afterwards"),
    "offline": ("recordings", "train a policy from recordings alone"),
    "replay": ("recordings", "recompute the updates of a recording and check that they are bit-identical"),
    "export": ("policies", "export a policy for use without rkhs_ros, or recorded episodes as a LeRobotDataset"),
    "compare": ("studies", "plot and tabulate the learning curves of several runs"),
    "sweep": ("studies", "train at each point of a grid of settings, with several seeds"),
    "reproduce": ("studies", "reproduce the figures of the paper"),
    "simulate": ("tasks", "run a simulator, or the nodes of a robot, for learners of other libraries"),
    "status": ("robot", "show the status of the nodes of a run"),
    "robot": ("robot", "send an operator command to the nodes of a robot: arm, stop, start, pause or veto"),
    "tune-node": ("tune_node", "tune the parameters of a ROS 2 node in a few dozen trials"),
    "list": ("tasks", "list the tasks, algorithms, kernels and figures"),
}
# Linear algebra uses one thread, also in nodes and workers, which inherit this; numpy is not imported yet.
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
NAMES_CODE = re.compile(r"\w:[A-Za-z_]|\.ya?ml$")  # MODULE:NAME, or a configuration, which may name modules


class Parser(argparse.ArgumentParser):
    """Argument parser that reports errors in one line."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.register("type", Path, _path)

    def error(self, message: str) -> NoReturn:
        """Raise ValueError."""
        raise ValueError(f"{message} (see '{self.prog} --help')")


def _path(word: str) -> Path:
    """Reject an empty argument, for example from an unset variable, which would mean the current folder."""
    if not word:
        raise argparse.ArgumentTypeError("expected a path, got an empty text")
    return Path(word)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line: print one line and exit with code 2 for bad input, 1 for a failure."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # like Ctrl-C: the run saves its policy
    os.environ.update(ONE_THREAD)
    if "_ARGCOMPLETE" in os.environ:
        _complete(os.environ["COMP_LINE"].split())
    sys.exit(_exit_code(sys.argv[1:] if arguments is None else arguments))


def _complete(words: Sequence[str]) -> None:
    """Pass the completions of a command line to the shell that requests them, and exit."""
    import argcomplete  # only here, since few calls need it

    parser = Parser(prog="rkhs")
    commands = parser.add_subparsers()
    for name in COMMANDS:
        command = commands.add_parser(name)
        if name in words:
            _declare(command, name)
    argcomplete.autocomplete(parser)


def _declare(parser: Parser, name: str) -> None:
    """Declare the arguments of a command, whose module is imported."""
    module = import_module(f"rkhs_ros.app.commands.{COMMANDS[name][0]}")
    function = name.replace("-", "_")
    getattr(module, f"add_{function}")(parser)
    parser.set_defaults(run=getattr(module, f"run_{function}"))


def _exit_code(arguments: Sequence[str]) -> int:
    try:
        if any(map(NAMES_CODE.search, arguments)):  # a file alone never extends the search
            search_here()
        options = parsed(arguments)
        code = int(options.run(options))
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader of the output, such as `head`, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, OSError, RunError) as error:
        return print_error(error)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED


def parsed(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the command line; import the module of the command."""
    width = max(map(len, COMMANDS))
    table = "\n".join(f"  {name:<{width}}  {about}" for name, (_, about) in COMMANDS.items())
    about, raw = "Policy search in reproducing kernel Hilbert spaces.", argparse.RawDescriptionHelpFormatter
    parser = Parser(prog="rkhs", description=about, epilog=f"commands:\n{table}", formatter_class=raw)
    parser.add_argument("--version", action="version", version=f"rkhs_ros {__version__}")
    parser.add_argument("command", metavar="COMMAND")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    called = parser.parse_args(arguments)
    if called.command not in COMMANDS:
        from rkhs_ros.base.validation import hint, truncated  # imports numpy, which would slow down --help

        raise ValueError(f"unknown command '{truncated(called.command)}', {hint(called.command, COMMANDS)}")
    _, about = COMMANDS[called.command]
    command = Parser(prog=f"rkhs {called.command}", description=f"{about[0].upper()}{about[1:]}.")
    _declare(command, called.command)
    return command.parse_intermixed_args(called.arguments)  # options may stand between files


if __name__ == "__main__":
    main()
