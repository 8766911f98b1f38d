"""A cluster of two nodes, both on this machine: one of them is stopped, or lost at once, while it works."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from .conftest import tiny
from .drivers import Driver, assert_as_undisturbed

pytest.importorskip("ray")
pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]

RUN = {**tiny()["base"], "steps": 2000, "checkpoint_every": 100}


class Node:
    """A node as `ray start` makes it, with one core."""

    def __init__(self, words: Path, environment: dict[str, str], *options: str) -> None:
        ray = str(Path(sys.executable).with_name("ray"))
        command = [ray, "start", "--block", "--num-cpus=1", "--node-ip-address=127.0.0.1", *options]
        with words.open("w") as file:
            self.process = subprocess.Popen(
                [*command, "--object-store-memory=100000000"],
                env=environment,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def stop(self) -> None:
        """Stop it as its owner would."""
        self.process.terminate()

    def lose(self) -> None:
        """End all of its processes at once, as when its machine loses its power."""
        me = psutil.Process(self.process.pid)
        for process in [me, *me.children(recursive=True)]:
            with contextlib.suppress(psutil.Error):
                process.kill()

    def close(self) -> None:
        self.lose()
        self.process.wait()


@pytest.fixture
def nodes(tmp_path: Path) -> Iterator[tuple[str, dict[str, str], Node]]:
    """Two nodes: address of the cluster, environment of its programs, and the node that is not the head."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    # Ray's sockets need a path shorter than those of pytest.
    scratch = tempfile.mkdtemp(prefix="bike-test-")
    own = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32), "RAY_USAGE_STATS_ENABLED": "0"}
    environment = {**os.environ, **own}
    head = Node(
        tmp_path / "head.txt",
        environment,
        *("--head", f"--port={port}", "--include-dashboard=false", f"--temp-dir={scratch}"),
    )
    other: Node | None = None
    try:
        address = f"127.0.0.1:{port}"
        other = Node(tmp_path / "other.txt", environment, f"--address={address}")
        yield address, environment, other
    finally:
        if other is not None:
            other.close()
        head.close()
        shutil.rmtree(scratch, ignore_errors=True)


def works_at(driver: Driver, node: Node) -> bool:
    """Return whether a run that has a checkpoint is done at a node."""
    for worker in driver.workers():
        with contextlib.suppress(psutil.Error):
            if node.process.pid in [parent.pid for parent in worker.parents()] and driver.checkpoints():
                return True
    return False


@pytest.mark.parametrize("end", ["stop", "lose"])
def test_runs_of_a_lost_node_go_on_at_another(end: str, nodes, tmp_path: Path, write, drive) -> None:
    address, environment, other = nodes
    spec = write(tiny(base=RUN, grid={"seed": [0, 1, 2]}))
    driver = drive(spec, tmp_path / "out", "--address", address, environment=environment)
    driver.until(lambda: works_at(driver, other))
    getattr(other, end)()
    assert driver.end() == 0, driver.words.read_text()
    attempts = [len(path.read_text().splitlines()) for path in (tmp_path / "out").glob("runs/*/attempts.jsonl")]
    assert len(attempts) == 3
    if end == "lose":  # a node that is stopped has half a minute to finish what it does
        assert max(attempts) == 2
    assert_as_undisturbed(spec, tmp_path / "out", tmp_path / "alone")
