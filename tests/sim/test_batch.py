"""Many vehicles side by side are the same as one by one, bit for bit, and share their courses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bike_sim.sim.batch import Batch, make_batch
from bike_sim.sim.bicycle_batch import CompiledBatch
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.simulator_batch import SimulatorBatch
from bike_sim.sim.superbike_plant import superbike_config

COMPILED = SimulatorConfig(engine="whipple", time_step=0.01)
PREVIEW = Preview(True, 0.4, 5)


def assert_rides_as_simulators(batch: Batch, config: SimulatorConfig, requests: list[ResetRequest], steps: int) -> None:
    """Ride a batch and simulators with the same commands; the rows begin one after the other, some twice."""
    commands = np.random.default_rng(0).uniform(-0.2, 0.2, (steps, len(requests), 2))
    simulators = [Simulator(config) for _ in requests]
    snapshots = [simulator.reset(request) for simulator, request in zip(simulators, requests, strict=True)]
    for index, request in enumerate(requests):
        batch.reset(index, request)
    for step in range(steps + 1):
        for index, snapshot in enumerate(snapshots):
            assert batch.state[index].tobytes() == snapshot.state.tobytes()
            assert batch.look[index].tobytes() == snapshot.look.tobytes()
            assert batch.signals[index].tobytes() == snapshot.signals.tobytes()
            assert batch.preview_y[index].tobytes() == snapshot.preview_y.tobytes()
            assert bool(batch.fallen[index]) == snapshot.fallen
            if snapshot.circuit is not None:
                assert isinstance(batch, SimulatorBatch)
                assert batch.place[index].tobytes() == snapshot.circuit.place.tobytes()
                assert batch.points[index].tobytes() == snapshot.circuit.points.tobytes()
        if step == steps:
            break
        batch.step(commands[step])
        snapshots = [s.step(*commands[step, index].tolist()) for index, s in enumerate(simulators)]
        if step == steps // 2:  # a row begins anew amid the rides of the others
            again = replace(requests[-1], course=requests[0].course, seed=99)
            batch.reset(0, again)
            snapshots[0] = simulators[0].reset(again)
    for simulator in simulators:
        simulator.close()


def test_bicycles_on_shared_courses_ride_as_one_by_one() -> None:
    courses = ["benchmark", "circle", "benchmark", "random", "circle", "benchmark", "random"]
    requests = [
        ResetRequest(seed=seed, course=course, speed_range=(4.0, 6.0), perturb=True, preview=PREVIEW)
        for seed, course in enumerate(courses)
    ]
    batch = make_batch(len(requests), COMPILED, PREVIEW)
    assert isinstance(batch, CompiledBatch)
    assert_rides_as_simulators(batch, COMPILED, requests, 40)
    batch.close()


@pytest.mark.parametrize("config", [COMPILED, SimulatorConfig(time_step=0.005)], ids=lambda config: config.engine)
def test_what_a_bicycle_sees_does_not_depend_on_its_neighbours(config: SimulatorConfig) -> None:
    request = ResetRequest(seed=1, course="benchmark", speed_range=(5.0, 5.0), perturb=True, preview=PREVIEW)
    alone, among = make_batch(1, config, PREVIEW), make_batch(3, config, PREVIEW)
    alone.reset(0, request)
    for index, course in enumerate(("circle", "benchmark", "random")):
        among.reset(index, request if index == 1 else replace(request, course=course, seed=index))
    for _ in range(20):
        alone.step(np.full((1, 2), 0.01))
        among.step(np.full((3, 2), 0.01))
        assert among.state[1].tobytes() == alone.state[0].tobytes()
        assert among.look[1].tobytes() == alone.look[0].tobytes()
    alone.close()
    among.close()


def test_superbikes_on_one_circuit_ride_as_one_by_one(courses: dict[str, str]) -> None:
    config = superbike_config("panigale_v4r")
    requests = [
        ResetRequest(
            seed=k,
            course=courses["circuit file"],
            speed_range=(18.0, 22.0),
            perturb=True,
            line=(1.0, 0.5)[k % 2],
            progress=100.0 * k,
        )
        for k in range(4)
    ]
    batch = make_batch(len(requests), config, PREVIEW)
    assert isinstance(batch, SimulatorBatch)
    assert_rides_as_simulators(batch, config, requests, 30)
    # One circuit and one line of it for all that ride it, however many they are.
    scenes = [simulator.scene for simulator in batch.simulators]
    assert scenes[1].track is scenes[3].track is scenes[2].track  # type: ignore[union-attr]
    assert scenes[1].course is scenes[3].course  # type: ignore[union-attr]
    assert scenes[1].course is not scenes[2].course  # type: ignore[union-attr]
    batch.close()


def test_a_course_is_stored_once_however_many_ride_it() -> None:
    batch = CompiledBatch(8, COMPILED, PREVIEW)
    for index in range(8):
        course = "benchmark" if index else "circle"
        batch.reset(index, ResetRequest(seed=index, course=course, speed_range=(4.0, 4.0), preview=PREVIEW))
    assert len(set(batch._course_of.tolist())) == 2
    assert sum(table.shape[1] > 2 for table in batch._tables.arrays) == 2  # the places of the others hold no samples
    batch.close()


def test_a_batch_goes_on_from_a_checkpoint_as_if_nothing_had_been() -> None:
    batch = CompiledBatch(3, COMPILED, PREVIEW)
    for index, course in enumerate(("benchmark", "random", "benchmark")):
        batch.reset(index, ResetRequest(seed=index, course=course, speed_range=(4.0, 4.0), preview=PREVIEW))
    batch.step(np.full((3, 2), 0.02))
    again = CompiledBatch(3, COMPILED, PREVIEW)
    again.restore(batch.state_dict())
    for rides in (batch, again):
        rides.reset(2, ResetRequest(seed=7, course="circle", speed_range=(4.0, 4.0), preview=PREVIEW))
        for _ in range(5):
            rides.step(np.full((3, 2), -0.01))
    assert again.state.tobytes() == batch.state.tobytes()
    assert again.look.tobytes() == batch.look.tobytes()
    assert again.preview_y.tobytes() == batch.preview_y.tobytes()


def test_a_compiled_batch_refuses_a_circuit_and_other_engines(courses: dict[str, str]) -> None:
    batch = CompiledBatch(1, COMPILED, PREVIEW)
    with pytest.raises(ValueError, match="is a circuit; a compiled batch of bicycles rides paths"):
        batch.reset(0, ResetRequest(course=courses["circuit file"], preview=PREVIEW))
    batch.close()
    with pytest.raises(ValueError, match=r"of bicycles needs one and engine .whipple., got .*pybullet"):
        CompiledBatch(1, SimulatorConfig(), PREVIEW)
