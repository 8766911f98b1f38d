"""A sweep whose workers and drivers are lost keeps all of it, bit for bit."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import time
from pathlib import Path

import psutil
import pytest

from bike_training.learning.run_settings import DEFAULT_SIMULATORS as SIMULATORS
from bike_training.sweeps.runs import make_plan
from bike_training.sweeps.spec import load_sweep

from .conftest import tiny
from .drivers import Driver, assert_as_undisturbed

pytest.importorskip("ray")
pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]

LONG_RUN = {**tiny()["base"], "steps": 2000, "checkpoint_every": 100}
"""A training of some seconds, with many checkpoints."""
SMALL_DISK = "700k"


def test_workers_killed_at_random_change_no_bit(tmp_path: Path, write, drive) -> None:
    spec = write(tiny(base=LONG_RUN, grid={"seed": [0, 1], "set.learner.gamma": [0.95, 0.99]}, retries=50))
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


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_driver_that_ends_is_taken_up_by_the_same_command(number: int, tmp_path: Path, write, drive) -> None:
    spec = write(tiny(base=LONG_RUN, grid={"seed": [0, 1]}, cores=0.5))
    out = tmp_path / "out"
    first = drive(spec, out, background=number == signal.SIGTERM)
    first.until(lambda: any(out.glob("runs/*/result.json")) and first.checkpoints())
    finished = {path: path.stat().st_mtime_ns for path in out.glob("runs/*/result.json")}
    if number == signal.SIGINT:
        first.type_control_c()
    else:
        first.process.send_signal(number)
    code = first.end()
    assert code == {signal.SIGKILL: -9, signal.SIGTERM: 143, signal.SIGINT: 130}[signal.Signals(number)]
    if number != signal.SIGKILL:
        assert "interrupted; runs that had begun go on" in first.words.read_text()
        assert (out / "runs.parquet").exists()
    second = drive(spec, out)
    assert second.end() == 0, second.words.read_text()
    assert all(path.stat().st_mtime_ns == when for path, when in finished.items())
    attempts = [len(path.read_text().splitlines()) for path in out.glob("runs/*/attempts.jsonl")]
    assert max(attempts) == 2
    assert_as_undisturbed(spec, out, tmp_path / "alone")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount a small disk")
def test_a_full_disk_costs_nothing_but_the_time_until_there_is_room(tmp_path: Path, write, drive) -> None:
    """The small disk holds the checkpoints of some runs and not those of all."""
    spec = write(tiny(base=LONG_RUN, grid={"seed": [0, 1, 2]}, retries=0))
    out = tmp_path / "disk" / "out"
    out.parent.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={SMALL_DISK}", "none", str(out.parent)], check=True)
    try:
        full = drive(spec, out, "--cores", "1")
        code, words = full.end(), full.words.read_text().splitlines()
        failures = [line for line in words if "failed:" in line]
        assert 1 <= len(failures) <= 2, words  # and the others have finished
        assert all("No space left on device" in line for line in failures)
        # Where there is no room for the tables either, that is told in one line as well.
        assert code == (2 if "runs.parquet cannot be written (No space left on device)" in words[-1] else 1), words
        subprocess.run(["mount", "-o", "remount,size=64m", str(out.parent)], check=True)
        again = drive(spec, out)
        assert again.end() == 0, again.words.read_text()
        assert_as_undisturbed(spec, out, tmp_path / "alone")
    finally:
        subprocess.run(["umount", "--lazy", str(out.parent)], check=True)


def test_four_runs_behind_ros_at_once_hear_their_own_simulators_only(tmp_path: Path, write, drive) -> None:
    """On two cores. Cross-talk would change what is learned, and every domain is that of one simulator."""
    spec = write(tiny(base={**tiny()["base"], "client": "ros"}, grid={"seed": [0, 1, 2, 3]}, cores=0.5))
    driver = drive(spec, tmp_path / "out", "--cores", "2")
    domains = driver.until(lambda: found if len(found := _domains(driver)) == 4 * SIMULATORS else None)
    assert len(set(domains)) == len(domains)
    assert driver.end() == 0, driver.words.read_text()
    assert_as_undisturbed(spec, tmp_path / "out", tmp_path / "alone")


def _domains(driver: Driver) -> list[str]:
    """Return the ROS domains of the simulators that run below a driver."""
    found = []
    for process in driver.family():
        with contextlib.suppress(psutil.Error):
            if "bike_sim.ros.sim_node" in process.cmdline():
                found.append(process.environ()["ROS_DOMAIN_ID"])
    return found
