"""Gaussian policies, their variance, and the random streams that actions are drawn from."""
