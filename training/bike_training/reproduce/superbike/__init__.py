"""The superbike paper: SAC with a self-paced curriculum, and without."""
