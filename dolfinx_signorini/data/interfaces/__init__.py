"""Curves and surfaces across which data jump, and meshes and rules that follow them."""
