"""Errors in norms, the orders to expect, and what errors are measured against."""
