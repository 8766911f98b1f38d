"""What all tests share: quick ones run first, and no test fails because the machine is busy."""

import os
import signal
import tempfile
from pathlib import Path

import hypothesis
import pytest

from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.superbike import Superbike

ROOT = Path(__file__).parents[1]

# Compiled functions make the first example slow, and machines of continuous integration are uneven. The same sources
# are tested with the same examples, so that a failure belongs to a change; `make test-long` looks for new ones.
for _profile, _derandomized in (("lab", True), ("explore", False)):
    hypothesis.settings.register_profile(
        _profile,
        deadline=None,
        derandomize=_derandomized,
        print_blob=True,
        suppress_health_check=[hypothesis.HealthCheck.too_slow],
    )
hypothesis.settings.load_profile("lab")

# A shell that starts this in the background has SIGINT ignored; programs under test would inherit that, and obey.
for _number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _number == signal.SIGINT else signal.SIG_DFL)


def pytest_configure(config: pytest.Config) -> None:
    """Lets JAX compile what many short runs of learning share once and not for each."""
    if hasattr(config, "workerinput"):
        return  # one of several processes that share the folder of the one that started them
    folder = tempfile.TemporaryDirectory(prefix="jax_")
    config.add_cleanup(folder.cleanup)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = folder.name
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Moves the slow tests to the end, and before them those that start ROS 2 nodes.

    Where several processes share the tests, those of one file that are of one kind stay together, because they share
    fixtures that take seconds.
    """

    def kind(item: pytest.Item) -> int:
        return 2 * bool(item.get_closest_marker("slow")) + bool(item.get_closest_marker("ros"))

    items.sort(key=kind)
    for item in items:
        item.add_marker(pytest.mark.xdist_group(f"{kind(item)} {item.path.name} {item.path.parent.name}"))


@pytest.fixture(scope="session")
def panigale() -> Superbike:
    machine = load_superbike("panigale_v4r")
    return machine
