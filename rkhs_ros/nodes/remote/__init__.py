"""Simulators and robots as Gymnasium environments, for learners of other libraries."""
