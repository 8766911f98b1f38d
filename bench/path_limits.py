"""How exactly a section of a course can be ridden at all, whatever steers.

The rides of several riders through a section are taken, from two seconds before it to two seconds after it, and their
steering commands are optimised with the whole section known, on the compiled engine: the same bicycle, drive, control
period and steering range. The best of the optima is shown. It starts from every rider's ride and accepts only what is
better, so none of them rides the section more exactly; it is still a local optimum, and the true bound may be lower.

The method is iterative LQR (Li and Todorov 2004, Iterative linear quadratic regulator design for nonlinear biological
movement systems, ICINCO): the ride is linearised, the linear problem is solved by a Riccati recursion, and its feedback
rides on the nonlinear bicycle, which keeps it upright over a window of many of its unstable time constants.

    python -m bench.path_limits whipple lqr --speeds 2 4 7
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from bike_policy.riders.making import make_rider
from bike_sim.course import projection
from bike_sim.course.course import Course
from bike_sim.course.files import load_course
from bike_sim.physics.state import ROLL, STATE_SIZE, STEER_RATE, X, Y
from bike_sim.physics.whipple_engine import advance
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle
from bike_training.rollout.riding import is_over, time_for
from bike_training.rollout.rollout import rollout

FloatArray = NDArray[np.float64]

MARGIN: Final = 2.0
"""Time before and after the section that is optimised too, s."""
TIME_STEP: Final = 0.01
ROUNDING: Final = 0.005
"""Distance below which |error| is rounded off for the optimiser, m."""
ROLL_LIMIT: Final = math.radians(45.0)
ROLL_PENALTY: Final = 100.0
"""Cost of a squared rad beyond the limit, m."""
STEP: Final = 1e-5
"""Half of the central differences."""
MOST_ITERATIONS: Final = 60
ENOUGH: Final = 1e-4
"""Relative gain of an iteration below which the optimiser stops."""
SHORTER: Final = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01)
"""Shares of the step that are tried."""
LEAST_CAUTION, MOST_CAUTION = 1e-6, 1e4
"""Weight of the squared change of a command, m/rad^2."""


@dataclass(frozen=True)
class Window:
    """A part of a ride on a course.

    Attributes:
        vehicle: bicycle.
        course: what is followed.
        state: minimal state at its beginning.
        progress: arc length there, m.
        commands: steering set values, rad.
    """

    vehicle: Vehicle
    course: Course
    state: FloatArray
    progress: float
    commands: FloatArray


class Ridden(NamedTuple):
    """A ride through a window.

    Attributes:
        commands: set values, rad, shape (n,).
        states: before each command and after the last, shape (n + 1, 10).
        errors: signed distance after each command, m, shape (n,).
        normals: derivative of each by x and y, shape (n, 2).
        cost: mean of the rounded distances and the penalties, m.
    """

    commands: FloatArray
    states: FloatArray
    errors: FloatArray
    normals: FloatArray
    cost: float


def ride(window: Window, command: Callable[[int, FloatArray], float]) -> Ridden:
    """Ride a window with commands that may depend on the state.

    Args:
        window: the part of a ride.
        command: set value (rad) by number of the step and state.
    """
    vehicle, course, state, s = window.vehicle, window.course, window.state.copy(), window.progress
    count, substeps = len(window.commands), round(vehicle.control_period / TIME_STEP)
    line = (course.x, course.y, course.heading, course.spacing, course.closed)
    commands, states = np.empty(count), np.empty((count + 1, STATE_SIZE))
    errors, normals, over = np.empty(count), np.empty((count, 2)), np.empty(count)
    states[0] = state
    for k in range(count):
        commands[k] = min(max(command(k, state), -vehicle.max_steer), vehicle.max_steer)
        advance(state, commands[k], TIME_STEP, substeps, vehicle.parameters)
        s, errors[k], _ = projection.project(*line, state[X], state[Y], s, 1.0, 3.0)
        _, _, along, across = projection.point_at(*line, s)
        normals[k] = -across, along
        over[k] = max(abs(state[ROLL]) - ROLL_LIMIT, 0.0)
        states[k + 1] = state
    cost = float(np.mean(np.sqrt(errors**2 + ROUNDING**2) + ROLL_PENALTY * over**2))
    return Ridden(commands, states, errors, normals, cost)


def linearised(window: Window, ridden: Ridden) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of each state by the one before, shape (n, 10, 10), and by the command, shape (n, 10)."""
    vehicle, count = window.vehicle, len(ridden.commands)
    substeps = round(vehicle.control_period / TIME_STEP)
    a, b = np.empty((count, STATE_SIZE, STATE_SIZE)), np.empty((count, STATE_SIZE))

    def after(state: FloatArray, command: float) -> FloatArray:
        moved = state.copy()
        advance(moved, command, TIME_STEP, substeps, vehicle.parameters)
        return moved

    axes = STEP * np.eye(STATE_SIZE)
    for k in range(count):
        state, command = ridden.states[k], float(ridden.commands[k])
        b[k] = (after(state, command + STEP) - after(state, command - STEP)) / (2.0 * STEP)
        for place, axis in enumerate(axes):
            a[k, :, place] = (after(state + axis, command) - after(state - axis, command)) / (2.0 * STEP)
    return a, b


def answers(ridden: Ridden, a: FloatArray, b: FloatArray, caution: float) -> tuple[FloatArray, FloatArray]:
    """Return the change of each command and its feedback that minimise the linearised cost: the Riccati recursion.

    The distance, which has a kink, is replaced by the parabola that touches it at the present one and lies above it.

    Args:
        ridden: about which the ride is linearised.
        a: as of :func:`linearised`.
        b: the same.
        caution: weight of the squared change of a command.
    """
    count = len(ridden.commands)
    slope, bend = np.zeros(STATE_SIZE), np.zeros((STATE_SIZE, STATE_SIZE))
    changes, feedback = np.empty(count), np.empty((count, STATE_SIZE))
    for k in reversed(range(count)):
        rounded = math.sqrt(ridden.errors[k] ** 2 + ROUNDING**2)
        normal, roll = ridden.normals[k], float(ridden.states[k + 1, ROLL])
        slope[[X, Y]] += ridden.errors[k] / rounded * normal
        bend[np.ix_([X, Y], [X, Y])] += np.outer(normal, normal) / rounded
        over = max(abs(roll) - ROLL_LIMIT, 0.0)
        if over:
            slope[ROLL] += 2.0 * ROLL_PENALTY * math.copysign(over, roll)
            bend[ROLL, ROLL] += 2.0 * ROLL_PENALTY
        by_command, both = float(b[k] @ slope), b[k] @ bend @ a[k]
        curvature = float(b[k] @ bend @ b[k]) + caution
        changes[k], feedback[k] = -by_command / curvature, -both / curvature
        slope = a[k].T @ slope + both * changes[k]
        bend = a[k].T @ bend @ a[k] + np.outer(both, feedback[k])
        bend = 0.5 * (bend + bend.T)
    return changes, feedback


def optimised(window: Window) -> Ridden:
    """Return the ride through a window with optimised commands; never worse than with its own."""
    best = ride(window, lambda k, _: float(window.commands[k]))
    caution, fresh = 1e-2, True
    a = b = np.empty(0)
    for _ in range(MOST_ITERATIONS):
        if fresh:
            a, b = linearised(window, best)
        changes, feedback = answers(best, a, b, caution)
        better = _stepped(window, best, changes, feedback)
        fresh = better is not None
        if better is None:
            caution *= 10.0
            if caution > MOST_CAUTION:
                break
            continue
        gain, best, caution = 1.0 - better.cost / best.cost, better, max(0.3 * caution, LEAST_CAUTION)
        if gain < ENOUGH:
            break
    return best


def _stepped(window: Window, base: Ridden, changes: FloatArray, feedback: FloatArray) -> Ridden | None:
    """Return the first ride with a share of the changes that is better, or None."""
    for share in SHORTER:

        def command(k: int, state: FloatArray, share: float = share) -> float:
            return float(base.commands[k] + share * changes[k] + feedback[k] @ (state - base.states[k]))

        tried = ride(window, command)
        if tried.cost < base.cost:
            return tried
    return None


def whole_ride(name: str, course_name: str, speed: float) -> list[Snapshot]:
    """Ride a course with a rider on the compiled engine."""
    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=TIME_STEP))
    rider = make_rider(name)
    request = ResetRequest(course=course_name, speed_range=(speed, speed))
    if rider.preview is not None:
        request = ResetRequest(course=course_name, speed_range=(speed, speed), preview=rider.preview)
    longest, snapshots = time_for(load_course(course_name), speed), []
    for snapshot in rollout(simulator, rider, request):
        snapshots.append(snapshot)
        if is_over(snapshot, longest):
            break
    simulator.close()
    return snapshots


def window_of(snapshots: list[Snapshot], course: Course, vehicle: Vehicle, first: float, last: float) -> Window:
    """Return the part of a ride from MARGIN before an arc length (m) to MARGIN after another."""
    speed = float(snapshots[0].look[lk.SPEED])
    progress = np.array([snapshot.look[lk.PROGRESS] for snapshot in snapshots])
    begin = int(np.searchsorted(progress, first - MARGIN * speed))
    end = min(int(np.searchsorted(progress, last + MARGIN * speed)), len(snapshots) - 1)
    commands = np.array([snapshot.steering * vehicle.max_steer for snapshot in snapshots[begin + 1 : end + 1]])
    return Window(vehicle, course, snapshots[begin].state, float(progress[begin]), commands)


def path_limits(
    riders: list[str], speeds: list[float], sections: list[str], course_name: str = "benchmark"
) -> list[dict[str, Any]]:
    """Return the limits of sections at speeds, with what riders reach in the same windows.

    Args:
        riders: names of riders, or folders of bundles.
        speeds: m/s.
        sections: names of sections.
        course_name: the course.
    """
    course, vehicle = load_course(course_name), load_vehicle("whipple")
    starts = [start for _, start in course.sections]
    rows: list[dict[str, Any]] = []
    found = [(place, name) for place, (name, _) in enumerate(course.sections) if name in sections]
    with tqdm(total=len(speeds) * len(found) * len(riders), unit="optimum", disable=None) as bar:
        for speed in speeds:
            rides = {name: whole_ride(name, course_name, speed) for name in riders}
            for place, section in found:
                last = starts[place + 1] if place + 1 < len(starts) else course.length
                row: dict[str, Any] = {"speed_m_s": speed, "section": section}
                optima = {}
                for name, snapshots in rides.items():
                    window = window_of(snapshots, course, vehicle, starts[place], last)
                    own = ride(window, lambda k, _, window=window: float(window.commands[k]))
                    row[f"{name}_mean_m"], row[f"{name}_max_m"] = _distances(own)
                    optima[name] = optimised(window)
                    bar.update()
                best = min(optima, key=lambda name: _distances(optima[name])[0])
                row["optimum_mean_m"], row["optimum_max_m"] = _distances(optima[best])
                rate = optima[best].states[:, STEER_RATE]
                row["optimum_steer_rate_deg_s"] = math.degrees(float(np.sqrt(np.mean(rate**2))))
                rows.append({**row, "from": best})
    return rows


def _distances(ridden: Ridden) -> tuple[float, float]:
    """Return mean and largest distance of a ride, m."""
    distance = np.abs(ridden.errors)
    return float(distance.mean()), float(distance.max())


def main() -> None:
    """Print the limits, as a table or as JSON."""
    parser = argparse.ArgumentParser(description="How exactly sections of the benchmark path can be ridden.")
    parser.add_argument("riders", nargs="*", default=["whipple", "lqr"])
    parser.add_argument("--speeds", type=float, nargs="+", default=[2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    parser.add_argument(
        "--sections", nargs="+", default=["full circle", "slalom", "soft lane change", "hard lane change"]
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = path_limits(args.riders, args.speeds, args.sections)
    if args.json:
        print(json.dumps(rows))
        return
    names = [*args.riders, "optimum"]
    print(
        f"{'m/s':>5} {'section':17}"
        + "".join(f"{name + ' mean':>14} {'max':>6}" for name in names)
        + "  its steer rate"
    )
    for row in rows:
        cells = "".join(f"{row[name + '_mean_m']:14.4f} {row[name + '_max_m']:6.3f}" for name in names)
        print(f"{row['speed_m_s']:5.2f} {row['section']:17}{cells} {row['optimum_steer_rate_deg_s']:10.0f} deg/s")


if __name__ == "__main__":
    main()
