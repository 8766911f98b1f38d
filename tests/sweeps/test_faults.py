"""What is left of a sweep when workers and drivers are lost: all of it, bit for bit."""

from __future__ import annotations

import random
import signal
import time
from pathlib import Path

import pytest

from bike_training.sweeps.plan import make_plan
from bike_training.sweeps.spec import load_sweep

from .conftest import tiny
from .drivers import assert_as_undisturbed

pytest.importorskip("ray")
pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]

LONG_RUN = {**tiny()["base"], "steps": 2000, "checkpoint_every": 100}
"""A training of some seconds, with many checkpoints."""


def test_workers_killed_at_random_change_no_bit(tmp_path: Path, write, drive) -> None:
    spec = write(tiny(base=LONG_RUN, grid={"seed": [0, 1], "set.gamma": [0.95, 0.99]}, retries=50))
    driver = drive(spec, tmp_path / "out")
    draw = random.Random(7)
    for _ in range(3):
        time.sleep(draw.uniform(0.0, 4.0))
        driver.until(driver.checkpoints)
        victims = driver.until(driver.workers)
        draw.choice(victims).kill()
    assert driver.end() == 0, driver.words.read_text()
    plan = make_plan(load_sweep(spec), tmp_path / "out")
    attempts = [len((run.folder / "attempts.jsonl").read_text().splitlines()) for run in plan.runs]
    assert sum(attempts) > len(attempts)
    assert_as_undisturbed(spec, tmp_path / "out", tmp_path / "alone")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_driver_that_ends_is_taken_up_by_the_same_command(number: int, tmp_path: Path, write, drive) -> None:
    spec = write(tiny(base=LONG_RUN, grid={"seed": [0, 1]}, cores=0.5))
    out = tmp_path / "out"
    first = drive(spec, out, background=number == signal.SIGTERM)
    first.until(lambda: any(out.glob("runs/*/result.json")) and first.checkpoints())
    finished = {path: path.stat().st_mtime_ns for path in out.glob("runs/*/result.json")}
    first.process.send_signal(number)
    code = first.end()
    assert code == {signal.SIGKILL: -9, signal.SIGTERM: 143}[signal.Signals(number)]
    if number != signal.SIGKILL:
        assert "interrupted; runs that had begun go on" in first.words.read_text()
        assert (out / "runs.parquet").exists()
    second = drive(spec, out)
    assert second.end() == 0, second.words.read_text()
    assert all(path.stat().st_mtime_ns == when for path, when in finished.items())
    attempts = [len(path.read_text().splitlines()) for path in out.glob("runs/*/attempts.jsonl")]
    assert max(attempts) == 2
    assert_as_undisturbed(spec, out, tmp_path / "alone")
