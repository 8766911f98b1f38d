"""What all tests share: quick ones run first, and no test fails because the machine is busy."""

import signal

import hypothesis
import pytest

# Compiled functions make the first example slow, and machines of continuous integration are uneven.
hypothesis.settings.register_profile("lab", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow])
hypothesis.settings.load_profile("lab")

# A shell that starts this in the background has SIGINT ignored; programs under test would inherit that, and obey.
for _number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _number == signal.SIGINT else signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Moves the slow tests to the end, and before them those that start ROS 2 nodes."""
    items.sort(key=lambda item: 2 * bool(item.get_closest_marker("slow")) + bool(item.get_closest_marker("ros")))
