"""Robots to practise on: processes that behave as hardware does, by the wall clock."""
