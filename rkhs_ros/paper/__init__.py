"""Reproduction of the paper's figures, and a check of its claims against them."""
