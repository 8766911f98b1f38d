"""Recordings of rides, read and explained without ROS.

    from bike_analysis import compare, open_ride

    recording = open_ride("ride.mcap")
    print(recording.rides[0].figures.mean_error_m)
    table = recording.rides[0].table()          # pandas
    both = compare(["a.mcap", "b.mcap"])        # aligned by the way along the course

From the raw file upwards: `container` (MCAP), `columns` (CDR), `reading` (typed columns), `rides`, `laps`, `metrics`,
`table`, `compare`, `api`, then plots, pages and `report`; each imports only those before it.
"""

from bike_analysis.api import RecordedLap, RecordedRide, RideRecording, compare, open_ride
from bike_analysis.compare import Comparison
from bike_analysis.container import RecordingError
from bike_analysis.metrics import RideFigures, ride_figures
from bike_analysis.reading import Recording, read_recording
from bike_analysis.rides import Ride, find_rides

__all__ = [
    "Comparison",
    "RecordedLap",
    "RecordedRide",
    "Recording",
    "RecordingError",
    "Ride",
    "RideFigures",
    "RideRecording",
    "compare",
    "find_rides",
    "open_ride",
    "read_recording",
    "ride_figures",
]
