"""Riding a policy, and judging the ride."""
