"""Solutions as accurate as asked: the adaptive loop, its estimates, and bounds."""
