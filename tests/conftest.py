"""What all tests share: quick ones run first, and no test fails because the machine is busy."""

import hypothesis
import pytest

# Compiled functions make the first example slow, and machines of continuous integration are uneven.
hypothesis.settings.register_profile("lab", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow])
hypothesis.settings.load_profile("lab")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Moves the slow tests to the end, and before them those that start ROS 2 nodes."""
    items.sort(key=lambda item: 2 * bool(item.get_closest_marker("slow")) + bool(item.get_closest_marker("ros")))
