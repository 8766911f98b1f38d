"""Starts of learners on circuits: at a share of the theoretical speed, beside the line and across it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as some

from bike_sim.physics import state as st
from bike_sim.schema import SIGNALS
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from tests.sim.conftest import STADIUM


@pytest.fixture(scope="module")
def machine() -> Iterator[Simulator]:
    machine = Simulator(replace(superbike_config("panigale_v4r"), engine="compiled"))
    yield machine
    machine.close()


@given(
    progress=some.floats(0.0, 1200.0),
    share=some.floats(0.2, 0.9),
    offset=some.floats(-3.0, 3.0),
    heading=some.floats(-0.3, 0.3),
    line=some.sampled_from((0.0, 0.5, 1.0)),
)
@example(progress=0.0, share=0.5, offset=2.0, heading=0.0, line=1.0)  # 0.9 m outside, on the bumps of the grass
def test_a_start_is_where_and_as_fast_as_asked(
    machine: Simulator, circuit: Path, progress: float, share: float, offset: float, heading: float, line: float
) -> None:
    request = ResetRequest(
        course=str(circuit), progress=progress, speed_share=share, start_offset=offset, start_heading=heading, line=line
    )
    snapshot = machine.reset(request)
    assert snapshot.look[lk.LATERAL_ERROR] == pytest.approx(offset, abs=1e-3)
    assert snapshot.look[lk.HEADING_ERROR] == pytest.approx(heading, abs=1e-3)
    followed = machine.begun.followed  # type: ignore[union-attr]
    limit = followed.limit(machine.plant.envelope)  # type: ignore[union-attr, arg-type]
    asked = share * float(limit.speed_at(followed.place(progress)))  # type: ignore[union-attr]
    assert snapshot.speed == pytest.approx(asked, rel=0.02)  # of the frame, which leans inwards
    margins = snapshot.circuit.limits  # type: ignore[union-attr]
    assert margins[lk.REAR_LEFT] + margins[lk.REAR_RIGHT] == pytest.approx(12.0, abs=0.05)
    # the machine stands on the ground: it does not bounce
    loads = [
        machine.step(0.0, 0.0).signals[[SIGNALS.index("rear_load"), SIGNALS.index("front_load")]] for _ in range(3)
    ]
    assert np.min(loads) > 200.0


def test_a_start_beside_the_road_has_the_grip_of_the_run_off(machine: Simulator, circuit: Path) -> None:
    snapshot = machine.reset(ResetRequest(course=str(circuit), start_offset=7.0, line=0.0, speed_range=(10.0, 10.0)))
    assert snapshot.off_course
    assert machine.batch.rows.ground["rear"]["grip"][0] < 1.0
    wrong = machine.reset(ResetRequest(course=str(circuit), start_heading=math.pi, speed_range=(10.0, 10.0)))
    assert wrong.circuit.limits[lk.WRONG_WAY]  # type: ignore[union-attr]
    right = machine.reset(ResetRequest(course=str(circuit), speed_range=(10.0, 10.0)))
    assert not right.circuit.limits[lk.WRONG_WAY]  # type: ignore[union-attr]


def test_starts_that_cannot_be_are_refused_with_their_value(machine: Simulator, tmp_path: Path) -> None:
    for field, value in (
        *(("speed_share", wrong) for wrong in (-0.1, 1.3, math.nan)),
        *(("start_offset", wrong) for wrong in (1001.0, -math.inf, math.nan)),
        *(("start_heading", wrong) for wrong in (3.2, math.nan)),
    ):
        with pytest.raises(ValueError, match=f"{field.replace('speed_', 'speed ')} must be .*{value!r}"):
            ResetRequest(**{field: value})
    for field in ("speed_share", "start_offset", "start_heading"):
        with pytest.raises(ValueError, match=f"{field} 0.5 is for circuits; course 'line' is a path"):
            machine.reset(ResetRequest(course="line", **{field: 0.5}))
    bicycle = Simulator(SimulatorConfig(engine="whipple"))
    circuit = tmp_path / "stadium.yaml"
    circuit.write_text(STADIUM, encoding="utf-8")
    with pytest.raises(ValueError, match=r"speed share 0\.5 is for superbikes: vehicle 'whipple'"):
        bicycle.reset(ResetRequest(course=str(circuit), speed_share=0.5))
    beside = bicycle.reset(ResetRequest(course=str(circuit), start_offset=0.5, speed_range=(5.0, 5.0)))
    assert beside.look[lk.LATERAL_ERROR] == pytest.approx(0.5, abs=1e-3)
    bicycle.close()


def test_time_outside_and_walls_add_up(machine: Simulator, circuit: Path) -> None:
    """Time with a tyre outside is no less than that with both, and grows only there; a wall takes the normal part."""
    snapshot = machine.reset(ResetRequest(course=str(circuit), speed_range=(30.0, 30.0)))
    before = 0.0
    while not snapshot.fallen:
        margins = snapshot.circuit.limits  # type: ignore[union-attr]
        out = margins[: lk.OUTSIDE].min() < 0.0
        snapshot = machine.step(0.0, 0.3)
        after = snapshot.circuit.limits  # type: ignore[union-attr]
        grown = after[lk.OFF_TRACK_TIME] - before
        assert -1e-12 <= grown <= machine.config.control_period + 1e-12
        if not out and after[: lk.OUTSIDE].min() > 0.0:
            assert grown == 0.0
        before = after[lk.OFF_TRACK_TIME]
    hit = snapshot.circuit.wall  # type: ignore[union-attr]
    assert hit is not None
    assert before >= machine.batch.timing(0).off_track > 0.0
    assert after[lk.WALL_ENERGY] == pytest.approx(hit.energy * math.sin(hit.angle) ** 2)


def test_rates_of_the_telemetry_are_those_of_the_motion(machine: Simulator, circuit: Path) -> None:
    fine = Simulator(replace(superbike_config("panigale_v4r", 0.001), engine="compiled", control_period=0.001))
    fine.reset(ResetRequest(course=str(circuit), speed_range=(25.0, 25.0)))
    names = fine.plant.signal_names
    rows = []
    for k in range(1500):
        snapshot = fine.step(0.5 * math.sin(0.004 * k), 0.6 * math.sin(0.01 * k))
        rows.append([*snapshot.signals, *fine.batch._slot.bodies.motion["position"][0], snapshot.state[st.YAW]])  # type: ignore[attr-defined]
    told = np.array(rows)
    column = {name: told[:, k] for k, name in enumerate(names)}
    x, y, z, yaw = told[:, -4:].T
    for rate, value, tolerance in (
        ("pitch_rate_rad_s", column["pitch_rad"], 0.02),
        ("vertical_velocity_m_s", z, 0.02),
        ("lean_reference_rate_rad_s", column["lean_reference_rad"], 0.02),
    ):
        # what is told is of the beginning of the step that led to the state
        steps = np.diff(value) / 0.001 if rate != "vertical_velocity_m_s" else np.diff(np.r_[z[0], z])[:-1] / 0.001
        assert column[rate][1:] == pytest.approx(steps, abs=tolerance * max(1.0, np.abs(steps).max())), rate
        assert np.abs(column[rate]).max() > 0.01
    sideways = (np.cos(yaw[:-1]) * np.diff(y) - np.sin(yaw[:-1]) * np.diff(x)) / 0.001
    assert column["lateral_velocity_m_s"][2:] == pytest.approx(sideways[:-1], abs=0.1)
    assert np.abs(sideways).max() > 0.3
    assert 0.0 <= column["brake_share"].min() < column["brake_share"].max() <= 1.0
    assert 0.0 <= column["drive_share"].min() < column["drive_share"].max() <= 1.0
    assert np.abs(column["rider_integral_nm"]).max() > 0.1
    fine.close()
