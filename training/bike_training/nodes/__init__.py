"""Rides through simulator, policy and recorder nodes."""
