"""Subcommands of ``bike`` that belong to the analysis."""
