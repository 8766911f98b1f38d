"""Stability of a rider in closed loop: spectral radius about steady rides, and what is left of a push.

A rider that reacts too strongly to small deviations does not return to the path but swings about it, however well it
follows bends. One control period maps deviations from a steady ride onto the next ones; where the largest eigenvalue
of that map is larger than one in magnitude, the steady ride is unstable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.riders.base import Rider
from bike_sim.course.course import Course
from bike_sim.course.projection import point_at
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.batch import COMPILED_ENGINE
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_training.envs.clients import Client
from bike_training.rollout.rollout import is_over, rollout, with_preview

FloatArray = NDArray[np.float64]

SPEEDS: Final = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0)
"""Speeds of the figures, m/s."""
STRAIGHT: Final = "line"
TURN: Final = "circle"
"""Courses of the steady rides."""
SETTLING: Final = 20.0
"""Time after which a ride is taken as steady, s."""
WINDOW: Final = 5.0
"""Time at the end of a ride over which its swing is measured, s."""
PUSH: Final = 0.02
"""Roll that begins the ride whose swing is measured, rad."""

_STEP: Final = 1e-3
"""Half of the differences of the map's derivative: m, rad or rad/s."""
_NEWTON: Final = 20
_LONGEST: Final = 0.02
"""Largest move of a Newton step, m, rad or rad/s: an actor is far from linear."""
_CLOSE: Final = 1e-6
_LATERAL: Final = (st.ROLL, st.STEER, st.ROLL_RATE, st.STEER_RATE)
_SIZE: Final = 2 + len(_LATERAL)


def deviations(snapshot: Snapshot) -> FloatArray:
    """Return lateral error (m), heading error, roll, steer (rad), roll rate and steer rate (rad/s) of a snapshot."""
    look = snapshot.look
    return np.array([look[lk.LATERAL_ERROR], look[lk.HEADING_ERROR], *snapshot.state[list(_LATERAL)]])


def state_of(deviation: FloatArray, course: Course, s: float, steady: st.StateVector) -> st.StateVector:
    """Return the minimal state that deviates from a line at an arc length; the rest is that of a steady ride.

    Args:
        deviation: as of :func:`deviations`.
        course: the line.
        s: arc length of the rear contact, m.
        steady: state with the wheels' angles and rates.
    """
    state = steady.copy()
    x, y, along, across = point_at(course.samples, s)
    heading = math.atan2(across, along)
    state[st.X], state[st.Y] = x - deviation[0] * math.sin(heading), y + deviation[0] * math.cos(heading)
    state[st.YAW] = heading + deviation[1]
    state[list(_LATERAL)] = deviation[2:]
    return state


def settle(client: Client, rider: Rider, course: str, speed: float, roll: float = 0.0) -> list[Snapshot] | None:
    """Ride a course for SETTLING seconds.

    Args:
        client: simulator.
        rider: any.
        course: name of the course.
        speed: m/s.
        roll: at the start, rad.

    Returns:
        The snapshots; None where the ride failed.
    """
    request = with_preview(ResetRequest(course=course, speed_range=(speed, speed)), rider)
    if roll:
        state = st.upright_state(speed, client.vehicle.rF)
        state[st.ROLL] = roll
        request = replace(request, initial_state=tuple(state.tolist()))
    ride: list[Snapshot] = []
    for snapshot in rollout(client, rider, request):
        ride.append(snapshot)
        # A lap of a circle ends a ride that is evaluated, not one that settles.
        if snapshot.time > SETTLING - 1e-9 or (is_over(snapshot, SETTLING) and not snapshot.finished):
            break
    return ride if ride[-1].time > SETTLING - 1e-9 and not ride[-1].fallen else None


def spectral_radius(client: Client, rider: Rider, course: str, speed: float) -> float | None:
    """Return the spectral radius of one control period about the steady ride of a line of constant curvature.

    The steady ride is found by Newton's method from where a long ride has come to, so that unstable ones are found as
    well as stable ones.

    Args:
        client: simulator.
        rider: without memory of earlier steps.
        course: name of a straight or of a circle.
        speed: m/s.

    Returns:
        Largest magnitude of an eigenvalue; None where the ride fails or no steady ride is found.
    """
    ride = settle(client, rider, course, speed)
    if ride is None:
        return None
    line = client.course
    assert line is not None, "an episode was begun"
    # Far from both ends, so that all of the preview lies on the line.
    middle = ride[len(ride) // 2]
    s, steady = float(middle.look[lk.PROGRESS]), middle.state
    request = with_preview(ResetRequest(course=course, speed_range=(speed, speed)), rider)

    def following(deviation: FloatArray) -> FloatArray:
        start = tuple(state_of(deviation, line, s, steady).tolist())
        snapshots = rollout(client, rider, replace(request, initial_state=start))
        next(snapshots)
        return deviations(next(snapshots))

    first = np.mean([deviations(snapshot) for snapshot in ride[len(ride) // 2 :]], axis=0)
    slopes = _slopes_at_rest(following, first)
    return None if slopes is None else float(np.abs(np.linalg.eigvals(slopes)).max())


def _slopes_at_rest(following: Callable[[FloatArray], FloatArray], point: FloatArray) -> FloatArray | None:
    """Return the derivative of a map at the point that it maps onto itself; None where Newton's method fails."""
    for _ in range(_NEWTON):
        axes = _STEP * np.eye(_SIZE)
        slopes = np.array([(following(point + axis) - following(point - axis)) / (2.0 * _STEP) for axis in axes]).T
        error = following(point) - point
        if np.abs(error).max() < _CLOSE:
            return slopes
        move = np.linalg.solve(np.eye(_SIZE) - slopes, error)
        point = point + move * min(1.0, _LONGEST / max(float(np.abs(move).max()), 1e-12))
    return None


def swing(client: Client, rider: Rider, speed: float) -> dict[str, float | None]:
    """Return what is left of a small push at the end of a ride along a straight, None where the ride fails.

    It is the standard deviation of the set point of the steering angle, the RMS of the steering rate, and the mean
    lateral error.
    """
    names = ("swing_deg", "swing_steer_rate_deg_s", "offset_m")
    ride = settle(client, rider, STRAIGHT, speed, PUSH)
    if ride is None:
        return dict.fromkeys(names)
    end = [snapshot for snapshot in ride if snapshot.time > ride[-1].time - WINDOW]
    steering = np.array([snapshot.steering for snapshot in end]) * client.vehicle.max_steer
    rates = np.array([snapshot.state[st.STEER_RATE] for snapshot in end])
    rate = float(np.sqrt(np.mean(rates**2)))
    offset = float(np.mean([snapshot.look[lk.LATERAL_ERROR] for snapshot in end]))
    return dict(zip(names, (math.degrees(float(steering.std())), math.degrees(rate), offset), strict=True))


def stability(rider: Rider, speeds: Sequence[float] = SPEEDS) -> dict[str, Any]:
    """Return the figures of a rider's stability on the compiled engine, whose motion is exact.

    Args:
        rider: without memory of earlier steps.
        speeds: m/s.
    """
    client = Simulator(SimulatorConfig(engine=COMPILED_ENGINE, time_step=0.01))
    rows: list[dict[str, Any]] = [
        {
            "speed_m_s": speed,
            "spectral_radius_upright": spectral_radius(client, rider, STRAIGHT, speed),
            "spectral_radius_turn": spectral_radius(client, rider, TURN, speed),
            **swing(client, rider, speed),
        }
        for speed in speeds
    ]
    client.close()
    names = ("spectral_radius_upright", "spectral_radius_turn", "swing_deg")
    return {**{f"worst_{name}": _worst([row[name] for row in rows]) for name in names}, "stability": rows}


def is_stable(rider: Rider, config: SimulatorConfig, speeds: Sequence[float] = SPEEDS) -> bool:
    """Return whether the steady rides of a straight and of a circle are stable at all speeds.

    Args:
        rider: without memory of earlier steps.
        config: of the simulator.
        speeds: m/s.
    """
    with closing(Simulator(config)) as client:
        radii = (spectral_radius(client, rider, course, speed) for speed in speeds for course in (STRAIGHT, TURN))
        return all(radius is not None and radius < 1.0 for radius in radii)


def _worst(values: Sequence[float | None]) -> float | None:
    """Return the largest value; None, which is worse than any, where one is missing."""
    known = [value for value in values if value is not None]
    return max(known) if len(known) == len(values) else None
