"""Ride a simulator node in lockstep: it waits for each command, so the ride does not depend on the machine's speed.

    python examples/ros_lockstep.py

Needs `make setup`. Starts its own simulator node; `RosClient(join=DOMAIN)` rides one that runs. Takes some ten seconds.
"""

import argparse

from bike_policy.riders.rider import make_rider
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.envs.ros_client import RosClient
from bike_training.rollout.rollout import rollout


def main() -> None:
    """Ride a circle with the linear-quadratic rider."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated time")
    args = parser.parse_args()

    with RosClient(SimulatorConfig(time_step=0.005)) as client:
        print(f"simulator in ROS domain {client.domain_id}")
        for snapshot in rollout(client, make_rider("lqr"), ResetRequest(course="circle", speed_range=(5.0, 5.0))):
            if snapshot.step % 100 == 0:
                print(f"{snapshot.time:5.1f} s  {snapshot.distance:.3f} m from the circle")
            if snapshot.time >= args.seconds:
                break


if __name__ == "__main__":
    main()
