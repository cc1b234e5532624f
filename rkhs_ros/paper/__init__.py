"""Reproduction of the paper's figures."""
