"""Training, evaluation and the `bike` command."""
