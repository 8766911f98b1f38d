"""What a refinement leaves in its folder; named here for those that do not learn."""

from __future__ import annotations

from typing import Final

TABLE: Final = "refinement.csv"
"""A row for each comparison of actors."""
POLICY: Final = "policy"
"""Bundle of the best actor."""
