"""Sweeps on Ray: who can reach it, and that its runs are what they are without it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path

import psutil
import pytest

from bike_sim.recording.in_use import claim_folder
from bike_training.cli import main
from bike_training.sweeps import cluster
from bike_training.sweeps.runs import execute
from bike_training.sweeps.spec import load_sweep

from .conftest import assert_same, learned, tiny

pytest.importorskip("ray")


@pytest.mark.slow
def test_a_sweep_is_its_runs_one_that_fails_stops_no_other_and_ray_listens_here_only(
    tmp_path: Path, write, drive
) -> None:
    """One sweep for all of it, for it takes longer to start than to run. Every socket of every process is looked at."""
    spec, out = write(tiny(grid={"seed": [0, 1]})), tmp_path / "out"
    broken, whole = load_sweep(spec).runs
    damaged = out / "runs" / broken.name / "checkpoint" / "state.json"
    damaged.parent.mkdir(parents=True)
    damaged.write_text("{")
    driver = drive(spec, out, "--json", "--cores", "1")
    driver.until(driver.workers)
    addresses = set()
    for process in driver.family():
        try:
            addresses |= {link.laddr.ip for link in process.net_connections() if link.status in ("LISTEN", "NONE")}
        except psutil.Error:
            continue  # it has just ended
    assert addresses
    assert addresses <= {"127.0.0.1", "::ffff:127.0.0.1", "::1"}
    assert driver.end() == 1
    told, answer = driver.words.read_text().strip().splitlines()
    assert told.startswith(f"{broken.name}: failed: ValueError: ")
    figures = json.loads(answer)["figures"]
    assert figures["runs_by_status"] == {"finished": 1, "failed": 1, "interrupted": 0, "missing": 0}
    assert list(figures["failures"]) == [broken.name]
    assert execute(whole, tmp_path / "alone")["status"] == "finished"
    assert_same(learned(out / "runs" / whole.name), learned(tmp_path / "alone"))


def test_two_sweeps_do_not_share_a_folder(tmp_path: Path, write, capsys) -> None:
    with claim_folder(tmp_path):
        assert main(["sweep", str(write(tiny())), "--out", str(tmp_path)]) == 2
    assert f"in use by process {os.getpid()}" in capsys.readouterr().err


def test_an_attempt_to_start_ray_that_fails_leaves_no_process() -> None:
    """As on a machine that is so busy that Ray's servers come too late for it."""
    started: list[subprocess.Popen] = []

    class LateRay:
        def init(self, **_: object) -> None:
            started.append(subprocess.Popen(["sleep", "600"]))
            if len(started) < 3:
                raise Exception("it came too late")

        def shutdown(self) -> None:
            pass

    cluster._start(LateRay(), {})
    try:
        assert [process.wait(10) for process in started[:2]] == [-signal.SIGKILL] * 2
        assert started[2].poll() is None
    finally:
        for process in started:
            process.kill()
            process.wait()
