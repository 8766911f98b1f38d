"""What all tests share: their order, and that nothing is computed twice or fails because the machine is busy."""

import gc
import hashlib
import os
import pickle
import shutil
import signal
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

import hypothesis
import pytest

from bike_sim.planning import envelope, lap_limit
from bike_sim.planning.line_cache import FOLDER_VARIABLE, cache_folder
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.superbike import Superbike
from bike_training.cli import LINEAR_ALGEBRA_THREADS
from tests.circuits import OVAL, write_kidney

ROOT = Path(__file__).parents[1]

# Compiled functions make the first example slow, and machines of continuous integration are uneven. The same sources
# are tested with the same examples, so that a failure belongs to a change; `make test-long` looks for new ones.
for _profile, _derandomized, _examples in (("lab", True, 25), ("explore", False, 100)):
    hypothesis.settings.register_profile(
        _profile,
        deadline=None,
        derandomize=_derandomized,
        max_examples=_examples,
        print_blob=True,
        suppress_health_check=[hypothesis.HealthCheck.too_slow, hypothesis.HealthCheck.function_scoped_fixture],
    )
hypothesis.settings.load_profile("lab")

# A shell that starts this in the background has SIGINT ignored; programs under test would inherit that, and obey.
for _number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _number == signal.SIGINT else signal.SIG_DFL)


SESSION = "BIKE_TEST_SESSION"
"""Environment variable that names the folder that the processes of a session share."""


def compute_once(module: ModuleType, name: str) -> None:
    """Let a function that depends on its arguments alone be computed once for the same ones, in all processes."""
    function, known = getattr(module, name), dict[str, bytes]()

    def look_up(*arguments: Any) -> Any:
        key = hashlib.sha256(pickle.dumps(arguments)).hexdigest()
        path = Path(os.environ[SESSION]) / f"{name}_{key}"
        if key not in known and not path.exists():
            scratch = path.with_suffix(f".{os.getpid()}")
            scratch.write_bytes(pickle.dumps(function(*arguments)))
            scratch.replace(path)
        known[key] = known.get(key) or path.read_bytes()
        return pickle.loads(known[key])

    setattr(module, name, look_up)


# Most of the time of a short ride on a circuit is that of its plan.
compute_once(envelope, "_tables")
compute_once(lap_limit, "_solve")


def pytest_configure(config: pytest.Config) -> None:
    """Lets JAX compile what many short runs of learning share once and not for each; lines and plans are shared, too.

    Lines begin as a copy of the user's, which stay as they are. What JAX compiles is kept for the next session, and not
    optimised: tests run it a few times.
    """
    gc.disable()  # until all is collected: what is imported and collected stays
    if hasattr(config, "workerinput"):
        return  # one of several processes that share the folder of the one that started them
    folder = tempfile.TemporaryDirectory(prefix="bike_tests_")
    config.add_cleanup(folder.cleanup)
    os.environ[SESSION] = folder.name
    lines = Path(folder.name) / "lines"
    if cache_folder().is_dir():
        shutil.copytree(cache_folder(), lines)
    os.environ[FOLDER_VARIABLE] = str(lines)
    kept = config.cache.mkdir("jax") if config.cache else Path(folder.name) / "jax"
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(kept)
    # As in commands: tests run side by side, and threads of matrix products would wait for each other.
    os.environ.setdefault(LINEAR_ALGEBRA_THREADS, "1")
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"


def pytest_collection_finish() -> None:
    """Spares each later collection of garbage what stays: a million objects of packages and tests."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Moves the slow tests to the end, and before them those that start ROS 2 nodes.

    Where several processes share the tests it is the other way round, so that none waits for another in the end.
    """

    def kind(item: pytest.Item) -> int:
        return 2 * bool(item.get_closest_marker("slow")) + bool(item.get_closest_marker("ros"))

    items.sort(key=kind, reverse=hasattr(config, "workerinput"))


@pytest.fixture(scope="session")
def panigale() -> Superbike:
    machine = load_superbike("panigale_v4r")
    return machine


@pytest.fixture(scope="session")
def oval(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A small circuit, whose lines and plans take a moment."""
    path = tmp_path_factory.mktemp("circuits") / "oval.yaml"
    path.write_text(OVAL)
    return str(path)


@pytest.fixture(scope="session")
def kidney(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small circuit with bends both ways that nothing was tuned on."""
    return write_kidney(tmp_path_factory.mktemp("circuits") / "kidney.csv")
