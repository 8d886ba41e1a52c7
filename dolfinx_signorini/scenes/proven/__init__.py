"""Data of the proven energy bound, from the formulas of a scene."""
