"""Recorded rides, ridden again."""
