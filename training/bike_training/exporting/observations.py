"""Observations that an exported policy is compared with the actor on."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_policy.riders.rider import learned_rider
from bike_sim.sim.batch import COMPILED_ENGINE, SUPERBIKE_ENGINE
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.explain.observations import read_observations

SECONDS: Final = 20.0
"""Length of the ride where no recording is named, s."""


def observations_of(bundle: Bundle, recording: Path | None) -> tuple[NDArray[np.float32], str]:
    """Return what a policy sees, shape (n, layout size), and where: on a recorded ride, or on one of its own.

    Args:
        bundle: the policy.
        recording: a ride; None for `SECONDS` of the benchmark path or of Barcelona in this process.

    Raises:
        FileNotFoundError: there is no such recording.
        ValueError: a recording that this policy could not have ridden.
    """
    if recording is not None:
        found = read_observations(recording, bundle)
        return found.observations, f"{recording.name} ({found.course})"
    if bundle.layout.races:
        config = replace(superbike_config(bundle.vehicle), engine=SUPERBIKE_ENGINE)
        request = ResetRequest(course="barcelona")
    else:
        config = SimulatorConfig(vehicle=bundle.vehicle, engine=COMPILED_ENGINE, time_step=0.01)
        request = ResetRequest(course="benchmark", speed_range=(4.0, 4.0))
    rider, seen = learned_rider(bundle), []
    if rider.preview is not None:
        request = replace(request, preview=rider.preview)
    with closing(Simulator(config)) as simulator:
        snapshot = simulator.reset(request)
        assert simulator.course is not None
        rider.begin(simulator.vehicle, simulator.course, config.control_period, simulator.preview)
        while snapshot.time < SECONDS and not (snapshot.fallen or snapshot.finished):
            before, command = rider.seen, rider.command(snapshot)
            if command is None:
                break
            if rider.seen is not before and rider.seen is not None:
                seen.append(rider.seen)
            snapshot = simulator.step(*command)
    return np.stack(seen), f"{snapshot.time:g} s of {request.course}"
