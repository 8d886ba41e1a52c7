"""Speed against accuracy: measuring (rows of a grid), plots, rules, page, command."""
