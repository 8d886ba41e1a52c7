"""Proven bounds of the energy error, from fluxes in equilibrium with the load."""
