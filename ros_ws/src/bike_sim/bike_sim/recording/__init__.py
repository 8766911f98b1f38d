"""Recordings as rosbag2 (Jazzy) writes them to MCAP, without rosbag2 and without rclpy.

`RideRecorder` takes messages as the middleware hands them over, as raw CDR bytes, and never decodes them. What makes
the file a rosbag2 recording, which ``ros2 bag``, Foxglove and the ``rosbags`` library open, is around the messages:

* the MCAP profile ``ros2`` and one ``ros2msg`` schema a type (`definitions`);
* for each channel the offered QoS and, where the installed package has it, the type hash;
* rosbag2's own metadata as an MCAP metadata record, and as ``metadata.yaml`` next to the file (`metadata`).

All times are nanoseconds of one clock, usually the simulated time of the message.
"""

from bike_sim.recording.definitions import (
    MessageType,
    ShareResolver,
    ament_share,
    first_share,
    message_type,
    source_share,
)
from bike_sim.recording.in_use import Claim, claim_folder
from bike_sim.recording.metadata import LATCHED, NOTES_RECORD, Qos
from bike_sim.recording.recorder import CHUNK_BYTES, FLUSH_PERIOD_S, RideRecorder, Split

__all__ = [
    "CHUNK_BYTES",
    "FLUSH_PERIOD_S",
    "LATCHED",
    "NOTES_RECORD",
    "Claim",
    "MessageType",
    "Qos",
    "RideRecorder",
    "ShareResolver",
    "Split",
    "ament_share",
    "claim_folder",
    "first_share",
    "message_type",
    "source_share",
]
