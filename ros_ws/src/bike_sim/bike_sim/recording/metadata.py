"""Metadata of a recording, as rosbag2 writes it (version 9): offered QoS, ``metadata.yaml``.

Source: rosbag2_storage (``yaml.hpp``, ``qos.cpp``) and rosbag2_storage_mcap of ROS 2 Jazzy.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from bike_sim.recording.definitions import MessageType

METADATA_FILE: Final = "metadata.yaml"
NOTES_RECORD: Final = "ride_notes"
"""Name of the MCAP metadata record with the notes, which stands before the first chunk and so survives a kill."""
UNLIMITED: Final = 9223372036_854775807
"""rmw's infinite duration, ns: the largest int64."""

_METADATA_VERSION: Final = 9
_SECOND: Final = 1_000_000_000


@dataclass(frozen=True)
class Qos:
    """Quality of service that a publisher offers, in rosbag2's words.

    Attributes:
        depth: Length of the publisher's queue.
        reliability: ``reliable`` or ``best_effort``.
        durability: ``volatile`` or ``transient_local``.
        history: ``keep_last`` or ``keep_all``.
        deadline_ns: Longest time between two messages, ns.
        lifespan_ns: Time after which a message is no longer delivered, ns.
    """

    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    deadline_ns: int = UNLIMITED
    lifespan_ns: int = UNLIMITED

    def profile(self) -> dict[str, Any]:
        """The profile as rosbag2's metadata version 9 spells it."""
        return {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": _duration(self.deadline_ns),
            "lifespan": _duration(self.lifespan_ns),
            "liveliness": "automatic",
            "liveliness_lease_duration": _duration(UNLIMITED),
            "avoid_ros_namespace_conventions": False,
        }


LATCHED: Final = Qos(depth=1, durability="transient_local")
"""Of static data such as the course: a late subscriber still gets the last message."""


def bag_information(
    file: str,
    topics: Mapping[str, tuple[MessageType, Sequence[Qos], int]],
    start_ns: int,
    end_ns: int,
    notes: Mapping[str, str],
) -> dict[str, Any]:
    """Return what ``metadata.yaml`` says about a recording in one file.

    Args:
        file: Name of the file in its directory.
        topics: Type, offered QoS and number of messages of each topic.
        start_ns: Earliest log time, ns; 0 without messages.
        end_ns: Latest log time, ns.
        notes: Its notes.
    """
    span = {
        "duration": {"nanoseconds": max(0, end_ns - start_ns)},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
    }
    count = sum(count for *_, count in topics.values())
    return {
        "version": _METADATA_VERSION,
        "storage_identifier": "mcap",
        **span,
        "message_count": count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": name,
                    "type": kind.name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [qos.profile() for qos in offered],
                    "type_description_hash": kind.type_hash,
                },
                "message_count": messages,
            }
            for name, (kind, offered, messages) in topics.items()
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file],
        "files": [{"path": file, **span, "message_count": count}],
        "custom_data": dict(notes) or None,
        "ros_distro": os.environ.get("ROS_DISTRO", "jazzy"),
    }


def to_yaml(data: Any) -> str:
    """Return data as YAML without anchors, which rosbag2's reader of QoS profiles does not follow."""
    return yaml.dump(data, Dumper=_PlainDumper, sort_keys=False, default_flow_style=False)


def write_metadata_file(directory: Path, information: Mapping[str, Any]) -> None:
    """Write or replace ``metadata.yaml`` in one step, so that a kill never leaves half of it.

    Raises:
        OSError: If the disk refuses it; the file before stays.
    """
    temporary = directory / f"{METADATA_FILE}.tmp"
    try:
        temporary.unlink(missing_ok=True)
        with temporary.open("x", encoding="utf-8") as file:  # never through a link
            file.write(to_yaml({"rosbag2_bagfile_information": dict(information)}))
        temporary.replace(directory / METADATA_FILE)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def is_only_recording(path: Path) -> bool:
    """Whether the directory of an MCAP file holds no other recording and no metadata of another one."""
    if any(other != path for other in path.parent.glob("*.mcap")):
        return False
    return not (path.parent / METADATA_FILE).exists() or described_files(path.parent) == (path.name,)


def described_files(directory: Path) -> tuple[str, ...]:
    """Names of the files that ``metadata.yaml`` lists; none if it is missing, or not of rosbag2."""
    try:
        content = yaml.safe_load((directory / METADATA_FILE).read_text(encoding="utf-8"))
        return tuple(str(name) for name in content["rosbag2_bagfile_information"]["relative_file_paths"])
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError):
        return ()


class _PlainDumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _duration(nanoseconds: int) -> dict[str, int]:
    seconds, rest = divmod(min(nanoseconds, UNLIMITED), _SECOND)
    return {"sec": seconds, "nsec": rest}
