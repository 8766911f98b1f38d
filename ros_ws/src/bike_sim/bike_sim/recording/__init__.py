"""Recordings as rosbag2 (Jazzy) writes them to MCAP, without rosbag2 and without rclpy.

`recorder.RideRecorder` takes messages as the middleware hands them over, as raw CDR bytes, and never decodes them. What
makes the file a rosbag2 recording, which ``ros2 bag``, Foxglove and the ``rosbags`` library open, is around the
messages:

* the MCAP profile ``ros2`` and one ``ros2msg`` schema a type (`definitions`);
* for each channel the offered QoS and, where the installed package has it, the type hash;
* rosbag2's own metadata as an MCAP metadata record, and as ``metadata.yaml`` next to the file (`metadata`).

All times are nanoseconds of one clock, usually the simulated time of the message.
"""
