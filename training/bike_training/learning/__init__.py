"""A learning run: presets, learner, validations, checkpoints, recordings."""
