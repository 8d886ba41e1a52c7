"""The experiment and the theory of Christof and Haubner."""
