"""Register the project's tasks for all tests."""

import signal

import sim_nodes.envs  # noqa: F401

# Background jobs of a shell ignore SIGINT, and child processes inherit this. Tests interrupt child processes.
signal.signal(signal.SIGINT, signal.default_int_handler)
