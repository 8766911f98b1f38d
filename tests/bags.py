"""Recordings in several files, as rosbag2 leaves them where it is told to begin a new one after some time."""

from __future__ import annotations

from pathlib import Path

import yaml

from bike_analysis.read.container import Container
from bike_sim.recording.definitions import MessageType
from bike_sim.recording.metadata import NOTES_RECORD
from bike_sim.recording.recorder import RideRecorder


def split_recording(recording: Path, folder: Path, period_s: float) -> Path:
    """Write a recording into files of a period each, with the last course at the head of each; return the folder."""
    box, parts, course = Container(recording), [], None
    for message in box.messages():
        topic = box.channels[message.channel].topic
        if not parts or message.log_time_ns > parts[-1][0][1] + 1e9 * period_s:
            parts.append([] if course is None else [(course[0], message.log_time_ns, course[2])])
        parts[-1].append((topic, message.log_time_ns, message.data))
        course = parts[-1][-1] if topic.endswith("/course") else course
    for number, messages in enumerate(parts):
        with RideRecorder(
            folder / f"{folder.name}_{number}.mcap", metadata_file=False, notes=box.metadata.get(NOTES_RECORD)
        ) as recorder:
            for channel in box.channels.values():
                schema = box.schemas[channel.schema_id]
                recorder.add_topic(channel.topic, MessageType(schema.name, schema.data.decode()))
            for message in messages:
                recorder.write(message[0], message[2], message[1])
    information = {"relative_file_paths": [f"{folder.name}_{number}.mcap" for number in range(len(parts))]}
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}))
    return folder
