"""Nodes as processes, and rides through them."""
