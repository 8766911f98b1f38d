"""Frozen tasks that results are compared on: environments, evaluation with scores, and verification of results."""
