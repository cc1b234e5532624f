"""The project's own tasks are registered for every test."""

import signal

import sim_nodes.envs  # noqa: F401

# A shell ignores SIGINT in what it starts in the background, and so would the processes that tests interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)
