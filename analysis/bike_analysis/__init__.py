"""Recordings of rides, read and explained without ROS.

    from bike_analysis import read_recording, find_rides, ride_figures

    for ride in find_rides(read_recording("ride.mcap")):
        print(ride_figures(ride).mean_error_m)

From the raw file upwards: `container` (MCAP), `columns` (CDR), `reading` (typed columns), `rides`, `metrics`, `plots`,
`page` and `report`; each imports only those before it.
"""

from bike_analysis.container import RecordingError
from bike_analysis.metrics import RideFigures, ride_figures
from bike_analysis.reading import Recording, read_recording
from bike_analysis.rides import Ride, find_rides

__all__ = ["Recording", "RecordingError", "Ride", "RideFigures", "find_rides", "read_recording", "ride_figures"]
