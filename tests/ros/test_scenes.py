"""A superbike on a path and a bicycle on a circuit through ROS: as in process, bit for bit, in every field."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.events import EventKind
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.envs.clients import make_client
from bike_training.envs.ros_client import RosClient
from tests.same import assert_same
from tests.sim.conftest import STADIUM

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("compiled")]

FIRST = ResetRequest(course="line", speed_range=(4.0, 4.0))
"""A node begins an episode of its own when it starts, so that the first that a client asks for is the second."""


@pytest.fixture
def stadium(own_lines: Path, tmp_path: Path) -> str:
    path = tmp_path / "stadium.yaml"
    path.write_text(STADIUM, encoding="utf-8")
    return str(path)


def test_a_superbike_behind_ros_rides_a_path_and_then_a_circuit(stadium: str) -> None:
    config = superbike_config("panigale_v4r")
    local = Simulator(config)
    local.reset(ResetRequest(course="line", speed_range=(35.0, 35.0)))
    circuit = ResetRequest(seed=2, course=stadium, speed_range=(20.0, 20.0), line=0.5, progress=150.0, perturb=True)
    path = ResetRequest(seed=1, course="circle", speed_range=(10.0, 10.0), perturb=True)
    client = make_client("ros", config)
    assert isinstance(client, RosClient)
    with client:
        for request, end in ((path, 60), (circuit, 2000)):
            ours, theirs = local.reset(request), client.reset(request)
            kinds = []
            while True:
                assert_same(theirs, ours)
                kinds += [event.kind for event in theirs.events]
                if ours.fallen or ours.step == end:
                    break
                bend, lean = ours.look[lk.CURVATURE], math.radians(local.vehicle.virtual_rider.max_lean_deg)
                steering = math.atan(ours.speed**2 * bend / 9.81) / lean if request is path else 0.0
                ours, theirs = local.step(steering, 0.2), client.step(steering, 0.2)
            assert client.course is not None
            assert local.course is not None
            np.testing.assert_array_equal(client.course.x, local.course.x)
            assert client.preview == local.preview
    assert theirs.fall == "wall"
    assert theirs.circuit is not None
    assert theirs.circuit.wall is not None
    assert kinds[0] is EventKind.RESET
    assert kinds[-1] is EventKind.WALL
    local.close()


def test_a_bicycle_behind_ros_rides_a_circuit(stadium: str) -> None:
    config = SimulatorConfig(engine="whipple", time_step=0.005)
    local = Simulator(config)
    local.reset(FIRST)
    request = ResetRequest(
        seed=4,
        course=stadium,
        speed_range=(5.0, 6.0),
        line=0.25,
        progress=1020.0,
        perturb=True,
        preview=Preview(False, 2.0, 7),
    )
    with RosClient(config) as client:
        ours, theirs = local.reset(request), client.reset(request)
        events = [*ours.events]
        for _ in range(80):
            assert_same(theirs, ours)
            steering = -float(0.4 * ours.state[st.ROLL] + 0.1 * ours.state[st.ROLL_RATE])
            ours, theirs = local.step(steering), client.step(steering)
            events += ours.events
        assert_same(theirs, ours)
        assert client.preview == request.preview
    assert theirs.circuit is not None
    assert EventKind.SECTOR in {event.kind for event in events} or theirs.progress > 1028.3
    local.close()
