"""How exactly a section of a course can be ridden at all, whatever steers.

The policy's ride through a section is taken, from two seconds before it to two seconds after it, and its steering
commands are then optimised with the whole section known, on the compiled engine: the same bicycle, drive, control
period and steering range. What remains is not for a controller to gain.
The optimum is a local one (L-BFGS from the policy's own commands), so the true bound may be a little lower.

    python -m bench.path_limits whipple --speeds 2 4 7
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import minimize

from bike_policy.contract.bundle import Bundle, load_bundle
from bike_sim.course import projection
from bike_sim.course.course import Course
from bike_sim.course.files import load_course
from bike_sim.physics.state import ROLL, X, Y
from bike_sim.physics.whipple_engine import advance
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle

FloatArray = NDArray[np.float64]

MARGIN: Final = 2.0
"""Time before and after the section that is optimised too, s."""
TIME_STEP: Final = 0.01
ROUNDING: Final = 0.005
"""Distance below which |error| is rounded off for the optimiser, m."""
ROLL_LIMIT: Final = np.radians(45.0)
ROLL_PENALTY: Final = 100.0
STEP: Final = 1e-6
"""Step of the forward differences, rad."""
MOST_ITERATIONS: Final = 300


@njit(cache=True)
def _ride(
    state: FloatArray,
    s: float,
    commands: FloatArray,
    first: int,
    substeps: int,
    parameters: FloatArray,
    x: FloatArray,
    y: FloatArray,
    heading: FloatArray,
    spacing: float,
    closed: bool,
    states: FloatArray,
    places: FloatArray,
    costs: FloatArray,
    errors: FloatArray,
) -> None:
    """Ride commands (set points, rad) from a state on; fill state and place before, cost and error (m) after each."""
    state = state.copy()
    for k in range(first, len(commands)):
        states[k], places[k] = state, s
        advance(state, commands[k], TIME_STEP, substeps, parameters)
        s, error, _ = projection.project(x, y, heading, spacing, closed, state[X], state[Y], s, 1.0, 3.0)
        over = max(abs(state[ROLL]) - ROLL_LIMIT, 0.0)
        errors[k] = error
        costs[k] = np.sqrt(error * error + ROUNDING**2) + ROLL_PENALTY * over * over


@njit(cache=True)
def _cost_and_gradient(
    state: FloatArray,
    s: float,
    commands: FloatArray,
    substeps: int,
    parameters: FloatArray,
    x: FloatArray,
    y: FloatArray,
    heading: FloatArray,
    spacing: float,
    closed: bool,
    errors: FloatArray,
) -> tuple[float, FloatArray]:
    """Return the mean cost and its gradient by forward differences; a command acts only on what comes after it."""
    count = len(commands)
    states, places, costs = np.empty((count, len(state))), np.empty(count), np.empty(count)
    line = (x, y, heading, spacing, closed)
    _ride(state, s, commands, 0, substeps, parameters, *line, states, places, costs, errors)
    after = np.cumsum(costs[::-1])[::-1]
    gradient = np.empty(count)
    probe, probe_states = commands.copy(), np.empty((count, len(state)))
    probe_places, probe_costs, probe_errors = np.empty(count), np.empty(count), np.empty(count)
    for k in range(count):
        probe[k] += STEP
        _ride(
            states[k],
            places[k],
            probe,
            k,
            substeps,
            parameters,
            *line,
            probe_states,
            probe_places,
            probe_costs,
            probe_errors,
        )
        gradient[k] = (probe_costs[k:].sum() - after[k]) / STEP / count
        probe[k] = commands[k]
    return costs.mean(), gradient


@dataclass(frozen=True)
class Window:
    """A part of a ride.

    Attributes:
        state: minimal state at its beginning.
        progress: arc length there, m.
        commands: steering set points, rad.
    """

    state: FloatArray
    progress: float
    commands: FloatArray


def policy_ride(bundle: Bundle, course_name: str, speed: float) -> list[Snapshot]:
    """Ride a course with a policy on the compiled engine."""
    layout = bundle.layout
    preview = Preview(layout.preview_by_time, layout.preview_interval, layout.preview_count)
    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=TIME_STEP))
    snapshots = [simulator.reset(ResetRequest(course=course_name, speed_range=(speed, speed), preview=preview))]
    while not (snapshots[-1].finished or snapshots[-1].fallen or snapshots[-1].off_course):
        action = bundle.actor.act(layout.observe(snapshots[-1]))
        snapshots.append(simulator.step(*bundle.action.to_command(action, simulator.vehicle.max_steer)))
    return snapshots


def section_limit(
    snapshots: list[Snapshot], course: Course, vehicle: Vehicle, first: float, last: float
) -> dict[str, Any]:
    """Optimise the ride through a section.

    Args:
        snapshots: the policy's ride.
        course: what it followed.
        vehicle: the bicycle.
        first: arc length at which the section begins, m.
        last: arc length at which it ends, m.

    Returns:
        Mean and largest distance of the policy and of the optimised commands in the same window.
    """
    speed = float(snapshots[0].look[lk.SPEED])
    progress = np.array([snapshot.look[lk.PROGRESS] for snapshot in snapshots])
    begin = int(np.searchsorted(progress, first - MARGIN * speed))
    end = min(int(np.searchsorted(progress, last + MARGIN * speed)), len(snapshots) - 1)
    commands = np.array([s.steering * vehicle.max_steer for s in snapshots[begin + 1 : end + 1]])
    window = Window(snapshots[begin].state, float(progress[begin]), commands)
    substeps = round(vehicle.control_period / TIME_STEP)
    line = (course.x, course.y, course.heading, course.spacing, course.closed)
    errors = np.empty(len(commands))

    def cost(values: FloatArray) -> tuple[float, FloatArray]:
        found: tuple[float, FloatArray] = _cost_and_gradient(
            window.state, window.progress, values, substeps, vehicle.parameters, *line, errors
        )
        return found

    cost(commands)
    policy = np.abs(errors)
    bounds = [(-vehicle.max_steer, vehicle.max_steer)] * len(commands)
    found = minimize(cost, commands, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": MOST_ITERATIONS})
    cost(found.x)
    best = np.abs(errors)
    return {
        "policy_mean_m": float(policy.mean()),
        "policy_max_m": float(policy.max()),
        "optimum_mean_m": float(best.mean()),
        "optimum_max_m": float(best.max()),
    }


def path_limits(
    policy: str, speeds: list[float], sections: list[str], course_name: str = "benchmark"
) -> list[dict[str, Any]]:
    """Return the limits of sections at speeds.

    Args:
        policy: name or folder of a bundle.
        speeds: m/s.
        sections: names of sections.
        course_name: the course.
    """
    bundle, course = load_bundle(policy), load_course(course_name)
    vehicle = load_vehicle(bundle.vehicle)
    starts = [start for _, start in course.sections]
    rows = []
    for speed in speeds:
        snapshots = policy_ride(bundle, course_name, speed)
        for place, (name, first) in enumerate(course.sections):
            if name in sections:
                last = starts[place + 1] if place + 1 < len(starts) else course.length
                limit = section_limit(snapshots, course, vehicle, first, last)
                rows.append({"speed_m_s": speed, "section": name, **limit})
    return rows


def main() -> None:
    """Print the limits, as a table or as JSON."""
    parser = argparse.ArgumentParser(description="How exactly sections of the benchmark path can be ridden.")
    parser.add_argument("policy", nargs="?", default="whipple")
    parser.add_argument("--speeds", type=float, nargs="+", default=[2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    parser.add_argument(
        "--sections", nargs="+", default=["full circle", "slalom", "soft lane change", "hard lane change"]
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = path_limits(args.policy, args.speeds, args.sections)
    if args.json:
        print(json.dumps(rows))
        return
    print(f"{'m/s':>5} {'section':20} {'policy mean':>12} {'max':>7} {'optimum mean':>13} {'max':>7}   (m)")
    for row in rows:
        print(
            f"{row['speed_m_s']:5.2f} {row['section']:20} {row['policy_mean_m']:12.4f} {row['policy_max_m']:7.3f}"
            f" {row['optimum_mean_m']:13.4f} {row['optimum_max_m']:7.3f}"
        )


if __name__ == "__main__":
    main()
