"""What is known about formulas: values on whole cells, derivatives, jumps and narrow features."""
