"""Knowledge about formulas: values on whole cells, derivatives, jumps and narrow peaks."""
