"""What every room uses: errors on all ranks, kinds of arguments, progress, records, versions."""
