"""The nodes, and everything that knows messages, parameters and domains."""
