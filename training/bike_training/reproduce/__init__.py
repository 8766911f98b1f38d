"""Experiments of publications, done again by one command."""
