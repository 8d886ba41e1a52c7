"""What the proven energy bound takes from the formulas of a scene."""
