"""A random path that bends as soon as it begins: riders held to less steering, and the optimum with the path known.

Evaluation starts a ride upright on its path. Where the path begins with a steep transfer, nothing can lean beforehand.

    python -m bench.steep_start lqr whipple
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from bench.path_limits import TIME_STEP, Window, optimised
from bike_policy.riders.making import make_rider
from bike_sim.sim import look as lk
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import RANDOM_COURSE, Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.rollout.evaluation import RANDOM_DURATION
from bike_training.rollout.riding import is_over


def ride_held(name: str, seed: int, speed: float, held: float, optimise: float) -> str:
    """Ride a random path of the evaluation, on the compiled engine, and return a line of the table.

    Args:
        name: of a rider.
        seed: of the path.
        speed: m/s.
        held: largest steering set value, rad.
        optimise: time from the start whose set values are then optimised, s.
    """
    simulator, rider = Simulator(SimulatorConfig(engine="whipple", time_step=TIME_STEP)), make_rider(name)
    request = ResetRequest(
        seed=seed,
        course=RANDOM_COURSE,
        speed_range=(speed, speed),
        path_length=1.2 * RANDOM_DURATION * speed + 20.0,
        preview=rider.preview or Preview(),
    )
    snapshots = [simulator.reset(request)]
    vehicle, course = simulator.vehicle, simulator.course
    assert course is not None, "an episode has begun"
    rider.begin(vehicle, course, vehicle.control_period, request.preview)
    most = held / vehicle.max_steer
    while not is_over(snapshots[-1], RANDOM_DURATION):
        command = rider.command(snapshots[-1])
        if command is None:
            break
        snapshots.append(simulator.step(min(max(command[0], -most), most), command[1]))
    simulator.close()
    error = np.abs([snapshot.look[lk.LATERAL_ERROR] for snapshot in snapshots])
    line = f"{name:10} {math.degrees(held):4.0f} {snapshots[-1].time:6.2f} s {error.mean():7.4f} {error.max():6.3f}"
    count = round(optimise / vehicle.control_period)
    if snapshots[-1].fallen or len(snapshots) <= count:
        return line + "  fell"
    commands = np.array([each.steering * vehicle.max_steer for each in snapshots[1 : count + 1]])
    best = optimised(Window(vehicle, course, snapshots[0].state, 0.0, commands))
    distance = np.abs(best.errors)
    return line + f" {error[1 : count + 1].mean():9.3f} {distance.mean():9.3f} {distance.max():6.3f}"


def main() -> None:
    """Print a line for each rider and largest set value."""
    parser = argparse.ArgumentParser(description="Riders on a random path that bends as soon as it begins.")
    parser.add_argument("riders", nargs="*", default=["lqr", "whipple"])
    parser.add_argument("--seed", type=int, default=100, help="of the random path")
    parser.add_argument("--speed", type=float, default=6.0, help="m/s")
    parser.add_argument("--held", type=float, nargs="+", default=[20, 30, 40, 50, 60, 70], help="degrees")
    parser.add_argument("--optimise", type=float, default=3.0, help="time from the start that is optimised, s")
    args = parser.parse_args()
    print(f"rider    held to  ridden    mean    max  first {args.optimise:g} s   optimum    max")
    for name in args.riders:
        for held in args.held:
            print(ride_held(name, args.seed, args.speed, math.radians(held), args.optimise), flush=True)


if __name__ == "__main__":
    main()
