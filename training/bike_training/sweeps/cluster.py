"""Ray: started on this machine for one sweep and bound to 127.0.0.1 alone, or one that runs already."""

from __future__ import annotations

import hashlib
import logging
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, Final

import psutil

from bike_training.interruption import interrupt, signals_handled

OBJECT_STORE: Final = 100 * 2**20
"""Shared memory of the local Ray, bytes: runs write files and hand back a few kilobytes."""
START_ATTEMPTS: Final = 3
SCRATCH: Final = "bike-ray-"
"""Beginning of the name of the folder with the sockets and logs of a local Ray; sockets need a short path."""

_LOCAL_ENVIRONMENT: Final = {
    # Named for other systems, this makes Ray take the loopback address as that of the machine: every server of it then
    # listens there alone. Its option for the address does not, because it puts the outer one in place of 127.0.0.1.
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "AUTOSCALER_METRIC_PORT": "-1",
    # A busy machine takes its time; Ray's own limit is that of an idle one.
    "RAY_worker_register_timeout_seconds": "600",
}
_ENVIRONMENT: Final = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_DISABLE_IMPORT_WARNING": "1",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    # A lost worker is reported here in one line, and not by Ray in ten, on standard output.
    "RAY_DEDUP_LOGS_SKIP_REGEX": "^",
    "RAY_AIR_NEW_OUTPUT": "0",
}
_SINGLE_THREAD: Final = "--xla_cpu_multi_thread_eigen=false"
"""A run has the cores that it declares and no others."""


@contextmanager
def ray_cluster(out: Path, address: str | None, cores: int | None) -> Iterator[Any]:
    """Connect to a cluster, or start Ray here and end it after the sweep.

    Args:
        out: folder of the sweep.
        address: of a running cluster, or None.
        cores: processor cores of this machine that the sweep may use; None for all. Without an address only.

    Yields:
        The module `ray`.

    Raises:
        ConnectionError: no cluster at the address.
    """
    os.environ.update({name: value for name, value in _ENVIRONMENT.items() if name not in os.environ})
    if address is None:
        os.environ.update(_LOCAL_ENVIRONMENT)
        if not os.environ.get("RAY_AUTH_MODE"):
            # Another user of this machine can reach 127.0.0.1 too, and must not start tasks here.
            os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    import ray  # it reads its environment while it is imported

    options: dict[str, Any] = {
        "include_dashboard": False,
        "log_to_driver": False,
        "logging_level": logging.ERROR,
        "configure_logging": True,
        "runtime_env": {"env_vars": _worker_environment()},
    }
    if address is not None:
        del options["include_dashboard"]
        try:
            ray.init(address=address, **options)
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise ConnectionError(f"--address {address}: no Ray cluster answers ({first_line(error)})") from None
    with nullcontext() if address is not None else _scratch(out) as scratch:
        if address is None:
            options |= {"num_cpus": cores or os.cpu_count(), "object_store_memory": OBJECT_STORE, "_temp_dir": scratch}
            _start(ray, options)
        try:
            with signals_handled(interrupt):  # as before Ray began, which puts handlers of its own in their place
                yield ray
        finally:
            ray.shutdown()


def _start(ray: Any, options: Mapping[str, Any]) -> None:
    """Start Ray here; it gives its processes 30 s, which a very busy machine may not.

    Raises:
        ConnectionError: it did not start, however often it was tried; no process of an attempt is left.
    """
    me = psutil.Process()
    for attempt in range(1, START_ATTEMPTS + 1):
        before = set(me.children())
        try:
            ray.init(**options)
            return
        except Exception as error:  # Ray raises many kinds, Exception itself among them
            ray.shutdown()
            for child in set(me.children()) - before:
                with suppress(psutil.Error):
                    child.kill()
            if attempt == START_ATTEMPTS:
                raise ConnectionError(f"Ray did not start on this machine ({first_line(error)})") from error


def _worker_environment() -> dict[str, str]:
    """Return what the processes of runs have in their environment beside that of their machine."""
    flags = os.environ.get("XLA_FLAGS", "")
    inherited = {name: os.environ[name] for name in ("PYTHONPATH", "BIKE_CACHE") if name in os.environ}
    return {**inherited, "XLA_FLAGS": flags if _SINGLE_THREAD in flags else f"{flags} {_SINGLE_THREAD}".strip()}


@contextmanager
def _scratch(out: Path) -> Iterator[str]:
    """Make the folder of a local Ray and remove it after use; its name finds one that a killed sweep has left."""
    digest = hashlib.sha256(str(out.resolve()).encode()).hexdigest()[:10]
    folder = Path(tempfile.gettempdir()) / f"{SCRATCH}{os.getuid()}-{digest}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(mode=0o700)
    try:
        yield str(folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def first_line(error: Exception) -> str:
    """Return the first line of an error's text, or the name of its kind where it has none."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
