"""Recordings of training are recordings like any other."""

import numpy as np
import pytest

from bike_policy.actor import Actor
from bike_sim.reset import ResetRequest
from bike_sim.simulator import Simulator, SimulatorConfig
from bike_training.curriculum import Curriculum
from bike_training.task import TASKS

pytest.importorskip("rclpy")


def test_recorded_ride_reads_back(tmp_path):
    from bike_analysis.report import analyze
    from bike_training.episode_recording import record_ride

    task = TASKS["lean"]
    actor = Actor([np.zeros((1, task.layout.size), dtype="f4")], [np.zeros(1, dtype="f4")])
    ranges = Curriculum().ranges(0)
    request = ResetRequest(
        seed=1, speed_range=ranges.speed, path_ranges=ranges.paths, perturb=True, preview=task.preview
    )
    path = tmp_path / "episode.mcap"
    record_ride(path, actor, task, Simulator(SimulatorConfig(engine="whipple", time_step=0.01)), request)
    figures = analyze(path, tmp_path)
    (ride,) = figures["rides"]
    assert ride["course"] == "random"
    assert ride["falls"] == 1  # nobody steers
    assert ride["lost_steps"] == 0
    assert not figures["truncated"]
