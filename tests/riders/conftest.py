"""Fixtures of the riders' tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Nothing has been verified before."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BIKE_CACHE", str(tmp_path_factory.mktemp("verified")))
        yield
