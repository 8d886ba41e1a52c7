"""Speed against accuracy: the grid of configurations, its measurement, and what is made of it."""
