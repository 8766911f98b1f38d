"""Read a recording into pandas: one row for each state, names with units.

    python examples/recording_to_pandas.py out/ride/ride.mcap

Needs `make setup` (`make ride` writes that recording), or the wheel without extras; no ROS. Takes a few seconds.
"""

import argparse

from bike_analysis import open_ride


def main() -> None:
    """Print figures of each ride, and errors by section of the course."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", nargs="?", default="out/ride/ride.mcap", help="MCAP file or rosbag2 directory")
    args = parser.parse_args()

    recording = open_ride(args.recording)
    for ride in recording.rides:
        table = ride.table()
        print(f"{ride.label}: {len(table)} states, mean distance {ride.figures.mean_error_m:.3f} m")
        print(table.assign(error_m=table.lateral_error_m.abs()).groupby("section", observed=True).error_m.max())


if __name__ == "__main__":
    main()
