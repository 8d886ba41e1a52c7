"""How pages of the site are made from scripts, scene files and definitions."""
