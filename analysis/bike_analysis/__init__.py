"""Recordings of rides, read and explained without ROS.

    from bike_analysis import compare, open_ride


    recording = open_ride("ride.mcap")
    print(recording.rides[0].figures.mean_error_m)
    table = recording.rides[0].table()          # pandas
    both = compare(["a.mcap", "b.mcap"])        # aligned by arc length along the course

Packages: `read` (files to typed columns), `figures` (columns to numbers), `page` (numbers to pages and pictures); each
imports only those before it. `report` is what ``bike analyze`` writes.
"""

from bike_analysis.figures.compare import Comparison
from bike_analysis.figures.laps import Lap
from bike_analysis.figures.metrics import Figures, ride_figures
from bike_analysis.figures.recorded import compare, open_ride
from bike_analysis.figures.rides import Ride, RideRecording, find_rides
from bike_analysis.read.container import RecordingError
from bike_analysis.read.reading import Recording, read_recording

__all__ = [
    "Comparison",
    "Figures",
    "Lap",
    "Recording",
    "RecordingError",
    "Ride",
    "RideRecording",
    "compare",
    "find_rides",
    "open_ride",
    "read_recording",
    "ride_figures",
]
