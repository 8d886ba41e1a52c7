"""Experiments with the solver: the paper's tables and theory, and speed against accuracy."""
