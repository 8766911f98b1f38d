"""Superbikes on a slope and on a banked ring, against closed-form solutions.

Both roads are the same everywhere, so what the machine does on them is known: a slope accelerates it by its share of
gravity, and on a ring that is banked by an angle the tyres carry what is left of the turn along the road.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.engine import NO_FALL
from bike_sim.physics.ground import Ground, flat_ground
from bike_sim.physics.superbike.engine import SuperbikeEngine
from bike_sim.physics.superbike.statics import inertial_mass
from bike_sim.schema import GRAVITY, SIGNALS

signal = SIGNALS.index

FloatArray = NDArray[np.float64]

GRADES: Final = (-0.08, 0.08)
"""Rise per m."""
BANKS_DEG: Final = (-8.0, 4.0, 8.0)
"""Banking in a turn, deg; positive falls to the inside."""
_PERIOD: Final = 0.02  # s
_SPEED: Final = 30.0  # m/s
_THROTTLE: Final = 0.12  # about holds the speed in the turn
_STEERING: Final = 0.6  # of the largest lean, to the right


@dataclass(frozen=True)
class RoadErrors:
    """How far one machine is off the closed-form solutions.

    Attributes:
        slope: of the acceleration by a slope, as a part of it.
        slope_load: of the load on a slope, as a part of it.
        side: of the side force on a banked ring, as a part of the weight.
        load: of the load on a banked ring, as a part of the weight.
        camber: of the lean to the road there, deg.
    """

    slope: float
    slope_load: float
    side: float
    load: float
    camber: float


def road_errors(engine: SuperbikeEngine) -> RoadErrors:
    """Measure one machine on all slopes and rings; the largest errors. A fall is an infinite error."""
    slopes = np.array([_slope_errors(engine, grade) for grade in GRADES])
    rings = np.array([_ring_errors(engine, math.radians(bank)) for bank in BANKS_DEG])
    return RoadErrors(*np.abs(slopes).max(axis=0).tolist(), *np.abs(rings).max(axis=0).tolist())


def _laid(**patch: float) -> Ground:
    ground = flat_ground()
    for wheel in ("rear", "front"):
        for name, value in patch.items():
            ground.record[wheel][name] = value
    return ground


def _coast(engine: SuperbikeEngine, grade: float) -> FloatArray:
    """Coast upright for 3 s and return speed, drag and load after each control period."""
    ground = _laid(grade=grade)
    engine.reset(st.upright_state(_SPEED, engine.vehicle.rF), ground)
    told = []
    for _ in range(round(3.0 / _PERIOD)):
        engine.advance(0.0, 0.0, round(_PERIOD / engine.time_step), ground)
        now = engine.telemetry()
        told.append(
            (
                now[signal("speed")],
                now[signal("drag")],
                now[signal("rear_load")] + now[signal("front_load")],
            )
        )
    return np.array(told)


def _slope_errors(engine: SuperbikeEngine, grade: float) -> tuple[float, float]:
    """Return the errors of acceleration and load on a slope, beside the same ride on level ground."""
    level, there = _coast(engine, 0.0), _coast(engine, grade)
    if engine.fall != NO_FALL:
        return math.inf, math.inf
    slope = math.atan(grade)
    part = slice(round(1.0 / _PERIOD), None)
    gained = np.polyfit(_PERIOD * np.arange(len(there[part])), there[part, 0] / math.cos(slope) - level[part, 0], 1)[0]
    # another speed meets another drag; the spin of the wheels is inertia too
    air = float((level[part, 1] - there[part, 1]).mean())
    expected = (air - engine.vehicle.mass * GRAVITY * math.sin(slope)) / inertial_mass(engine.vehicle)
    return gained / expected - 1.0, float(there[-1, 2] / (level[-1, 2] * math.cos(slope)) - 1.0)


def _lay_ring(ground: Ground, state: FloatArray, course: float, wheelbase: float, rise: float, bend: float) -> None:
    """Put the ring that the rear wheel stands on under both wheels: a cone about the centre of the turn to the right.

    Args:
        ground: written.
        state: minimal state.
        course: direction in which the rear wheel goes, rad.
        wheelbase: m.
        rise: to the left, per m.
        bend: of the turn, 1/m.
    """
    x, y, yaw = (float(state[k]) for k in (st.X, st.Y, st.YAW))
    for wheel, ahead in (("rear", 0.0), ("front", wheelbase)):
        patch = ground.record[wheel]
        patch["x"], patch["y"] = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw)
        along = course - ahead * bend
        patch["cos"], patch["sin"] = math.cos(along), math.sin(along)
        # a patch is straight, and straight ahead the outside of the ring rises
        outside = 0.5 * bend * ahead**2 + ahead * math.sin(yaw - course)
        patch["height"], patch["crest"] = rise * outside, rise * bend


def _ring_errors(engine: SuperbikeEngine, bank: float) -> tuple[float, float, float]:
    """Return the errors of side force, load (by the weight) and lean to the road (deg) in a steady right turn.

    With the lateral acceleration a of the turn, the tyres carry ``m (a cos(bank) - g sin(bank))`` along the road and
    ``m (g cos(bank) + a sin(bank))`` across it; the lean to the vertical is that of level ground.
    """
    vehicle, ground = engine.vehicle, _laid(bank=math.tan(bank))
    engine.reset(st.upright_state(_SPEED, vehicle.rF), ground)
    rows: list[tuple[float, ...]] = []
    before, bend = engine.state(), 0.0  # curvature of the ring, to the right, 1/m
    for _ in range(round(5.0 / _PERIOD)):
        state = engine.state()
        went = math.hypot(state[st.X] - before[st.X], state[st.Y] - before[st.Y])
        # a drifting machine does not go where its rear wheel points; from a chord to its end
        course = math.atan2(state[st.Y] - before[st.Y], state[st.X] - before[st.X]) - 0.5 * bend * went
        _lay_ring(ground, state, course if went else float(state[st.YAW]), vehicle.w, math.tan(bank), bend)
        before = state
        engine.advance(-_STEERING, _THROTTLE, round(_PERIOD / engine.time_step), ground)
        now = engine.telemetry()
        bend = -now[signal("yaw_rate")] / now[signal("speed")]
        rows.append(
            (
                -now[signal("yaw_rate")] * now[signal("speed")],
                -(now[signal("rear_force_lat")] + now[signal("front_force_lat")]),
                now[signal("rear_load")] + now[signal("front_load")],
                now[signal("rear_camber")],
                engine.state()[st.ROLL],
                now[signal("speed")],
            )
        )
    if engine.fall != NO_FALL:
        return math.inf, math.inf, math.inf
    turn, side, load, camber, roll, speed = np.array(rows[-round(1.0 / _PERIOD) :]).mean(axis=0)
    weight = vehicle.mass * GRAVITY
    # the wings press in the machine's plane
    wings = 0.5 * vehicle.air.density * vehicle.air.down_area * speed**2
    expected_side = vehicle.mass * (turn * math.cos(bank) - GRAVITY * math.sin(bank)) + wings * math.sin(camber)
    expected_load = vehicle.mass * (GRAVITY * math.cos(bank) + turn * math.sin(bank)) + wings * math.cos(camber)
    return (
        (side - expected_side) / weight,
        (load - expected_load) / weight,
        math.degrees(camber - (roll - bank)),
    )
