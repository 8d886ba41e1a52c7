"""The base of every room: errors on all ranks, kinds of arguments, progress, records, versions."""
