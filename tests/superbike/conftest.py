"""A small circuit, quick to compute, that all tests of riding superbikes share."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def circuit(kidney: Path) -> Path:
    return kidney
