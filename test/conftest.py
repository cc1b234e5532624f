"""The project's own tasks are registered for every test."""

import sim_nodes.envs  # noqa: F401
