"""Which episodes are drawn when."""
