"""Replay of recorded rides."""
