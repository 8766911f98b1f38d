"""Sweeps on Ray: who can reach it, and that its runs are what they are without it."""

from __future__ import annotations

import json
import os
from pathlib import Path

import psutil
import pytest

from bike_sim.recording.in_use import claim_folder
from bike_training.cli import main

from .conftest import tiny
from .drivers import assert_as_undisturbed

pytest.importorskip("ray")


@pytest.mark.slow
def test_ray_listens_on_this_machine_only_and_the_sweep_is_its_runs(tmp_path: Path, write, drive) -> None:
    """Every socket of every process of it; and what came of the runs is what comes of them without it."""
    spec = write(tiny(grid={"seed": [0, 1]}))
    driver = drive(spec, tmp_path / "out", "--json")
    driver.until(driver.workers)
    addresses = set()
    for process in driver.family():
        try:
            addresses |= {link.laddr.ip for link in process.net_connections() if link.status in ("LISTEN", "NONE")}
        except psutil.Error:
            continue  # it has just ended
    assert addresses
    assert addresses <= {"127.0.0.1", "::ffff:127.0.0.1", "::1"}
    assert driver.end() == 0
    printed = driver.words.read_text().strip().splitlines()
    assert len(printed) == 1, printed
    assert json.loads(printed[0])["figures"]["runs_by_status"]["finished"] == 2
    assert_as_undisturbed(spec, tmp_path / "out", tmp_path / "alone")


def test_two_sweeps_do_not_share_a_folder(tmp_path: Path, write, capsys) -> None:
    with claim_folder(tmp_path):
        assert main(["sweep", str(write(tiny())), "--out", str(tmp_path)]) == 2
    assert f"in use by process {os.getpid()}" in capsys.readouterr().err
