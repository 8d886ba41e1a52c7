"""The command line: one module per job, and main."""
