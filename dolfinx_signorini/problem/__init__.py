"""The Signorini problem as the user poses it: arguments, checks, assembly, and detachment."""
