"""Bicycles and superbikes on paths and circuits through ROS: as in process, bit for bit, in every field."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.events import EventKind
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_training.envs.ros_client import RosClient
from tests.same import assert_same
from tests.sim.conftest import STADIUM

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("compiled")]

BICYCLE, FINE = SimulatorConfig(time_step=0.005, history=7), SimulatorConfig(engine="whipple", time_step=0.005)
SUPERBIKE = superbike_config("panigale_v4r")
RANDOM = {"speed_range": (3.0, 6.0), "perturb": True}
STRAIGHT = {
    "seed": 2,
    "course": "stadium",
    "speed_range": (20.0, 20.0),
    "line": 0.5,
    "progress": 150.0,
    "perturb": True,
}
SEEN = {"seed": 4, "speed_range": (5.0, 6.0), "line": 0.25, "progress": 1020.0, "preview": Preview(False, 2.0, 7)}

Steer = Callable[[Snapshot], tuple[float, float]]


def upright(seen: Snapshot) -> tuple[float, float]:
    """Keep a bicycle up, with some noise of its own for each step."""
    noise = float(np.random.default_rng([seen.episode, seen.step]).normal())
    return float(np.clip(-0.4 * seen.state[st.ROLL] - 0.1 * seen.state[st.ROLL_RATE] + 0.01 * noise, -1.0, 1.0)), 0.0


def leaned(seen: Snapshot) -> tuple[float, float]:
    """Lean a superbike as its bend asks."""
    return math.atan(seen.speed**2 * seen.look[lk.CURVATURE] / 9.81) / math.radians(60.0), 0.2


RIDES: list[tuple[SimulatorConfig, list[tuple[dict, int, Steer]], set[EventKind]]] = [
    (BICYCLE, [({"seed": 11, **RANDOM}, 60, upright), ({"seed": 12, **RANDOM}, 60, upright)], set()),
    (FINE, [({"course": "stadium", "perturb": True, **SEEN}, 80, upright)], set()),
    (
        SUPERBIKE,
        [
            ({"seed": 1, "course": "circle", "speed_range": (10.0, 10.0), "perturb": True}, 60, leaned),
            ({"course": "stadium", **STRAIGHT}, 2000, lambda _: (0.0, 0.2)),
        ],
        {EventKind.WALL},
    ),
]


@pytest.mark.parametrize(("config", "rides", "kinds"), RIDES, ids=["paths", "bicycle on a circuit", "superbike"])
def test_a_ride_behind_ros_is_the_same(
    config: SimulatorConfig, rides: list[tuple[dict, int, Steer]], kinds: set[EventKind], tmp_path: Path
) -> None:
    stadium = tmp_path / "stadium.yaml"
    stadium.write_text(STADIUM, encoding="utf-8")
    local = Simulator(config)
    local.episode = 1  # a node begins an episode of its own when it starts
    happened = set()
    with RosClient(config) as client:
        for values, end, steer in rides:
            course = str(stadium) if values.get("course") == "stadium" else values.get("course", "random")
            request = ResetRequest(**values | {"course": course})
            ours, theirs = local.reset(request), client.reset(request)
            while True:
                assert_same(theirs, ours)
                happened |= {event.kind for event in theirs.events}
                if ours.fallen or ours.step == end:
                    break
                command = steer(ours)
                ours, theirs = local.step(*command), client.step(*command)
            assert ours.step > 30
            assert client.course is not None
            assert local.course is not None
            np.testing.assert_array_equal(client.course.x, local.course.x)
            np.testing.assert_array_equal(client.course.heading, local.course.heading)
            assert client.preview == local.preview
        assert happened >= kinds | {EventKind.RESET}
        for bad in (math.nan, 1.5):
            with pytest.raises((ValueError, RuntimeError), match=r"must lie in|ended with a fall"):
                client.step(bad)
        with pytest.raises(ValueError, match="no shipped course is called 'nowhere'"):
            client.reset(ResetRequest(course="nowhere"))
        if not ours.fallen:
            assert_same(client.step(0.0), local.step(0.0))
    local.close()
