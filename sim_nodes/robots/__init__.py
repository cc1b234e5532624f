"""Simulated robots: processes that behave like hardware, in real time."""
