"""Ride the benchmark path in this process: no ROS, no files.

    python examples/ride_in_process.py

Needs `make setup`, or the wheel without extras. Takes about ten seconds.
"""

import argparse

from bike_policy.riders.rider import make_rider
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator


def main() -> None:
    """Ride, and print the distance to the path every five seconds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rider", default="whipple", help="whipple, lqr, mpc, stanley, or the folder of a policy")
    parser.add_argument("--speed", type=float, default=4.0, help="m/s")
    parser.add_argument("--seconds", type=float, default=60.0, help="simulated time")
    args = parser.parse_args()

    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=0.01))
    rider = make_rider(args.rider)
    snapshot = simulator.reset(ResetRequest(course="benchmark", speed_range=(args.speed, args.speed)))
    rider.begin(simulator.vehicle, simulator.course, simulator.config.control_period, simulator.preview)
    while snapshot.time < args.seconds and not (snapshot.fallen or snapshot.finished):
        steering, throttle = rider.command(snapshot)  # both in [-1, 1]
        snapshot = simulator.step(steering, throttle)
        if snapshot.step % 100 == 0:
            print(f"{snapshot.time:5.1f} s  {snapshot.distance:.3f} m from the path")
    print("fallen" if snapshot.fallen else "upright")


if __name__ == "__main__":
    main()
