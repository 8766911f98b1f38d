"""Any topic of any ROS 2 bag as a table: one row a message, a column for each number or text."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bike_analysis.read.columns import MessageSchema, SchemaError
from bike_analysis.read.container import Container, RecordingError, examine_files
from bike_sim.documents import alternatives, show


def read_topic(path: str | os.PathLike[str], topic: str) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Read a topic.

    Args:
        path: An MCAP file or a rosbag2 directory, complete or truncated.
        topic: Its name, with or without the leading slash.

    Returns:
        The table: ``log_time_s``, then the fields in their order, nested ones by names with dots; arrays as lists. And
        what was missing or wrong, one sentence each.

    Raises:
        FileNotFoundError: There is no such recording.
        RecordingError: There is no such topic, or its messages cannot be read.
    """
    files, faults = examine_files(path)
    wanted, rows, known = f"/{topic.lstrip('/')}", [], dict[str, str]()
    warnings: dict[str, None] = dict.fromkeys(faults)
    for file in files:
        box = Container(file)
        schemas: dict[int, MessageSchema] = {}
        for message in box.messages():
            channel = box.channels.get(message.channel)
            if channel is None or channel.topic != wanted:
                continue
            try:
                if message.channel not in schemas:
                    schemas[message.channel] = _schema_of(box, message.channel)
                decoded = schemas[message.channel].decode(message.data)
            except SchemaError as error:
                warnings[f"messages of {wanted} are left out: {error}"] = None
                continue
            rows.append({"log_time_s": 1e-9 * message.log_time_ns} | dict(_fields(decoded, "")))
        known |= box.topics()
        if box.truncated:
            warnings[f"{file.name} is torn: {box.reason}; read up to its last whole chunk"] = None
    if not known:
        raise RecordingError(f"{path}: {[*warnings, 'it holds no topic'][0]}")
    if wanted not in known:
        raise RecordingError(f"{path} has no topic {show(wanted)}; {alternatives(wanted, known)}")
    if not rows:
        raise RecordingError(f"{path}: {[*warnings, f'no message of {wanted} was recorded'][0]}")
    return pd.DataFrame(rows), tuple(warnings)


def _schema_of(box: Container, channel_id: int) -> MessageSchema:
    channel = box.channels[channel_id]
    schema = box.schemas.get(channel.schema_id)
    if schema is None or channel.message_encoding != "cdr" or schema.encoding != "ros2msg":
        encoding = schema.encoding if schema else "no definition"
        raise SchemaError(f"they are {channel.message_encoding} by {encoding}, and CDR by ros2msg is read")
    return MessageSchema(schema.name, schema.data.decode("utf-8", errors="replace"))


def _fields(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield the fields of a message, nested messages resolved."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if not (field.name.isupper() or field.name.startswith("__")):  # constants, and the type's name
                yield from _fields(getattr(value, field.name), f"{name}.{field.name}".lstrip("."))
    else:
        yield name, _plain(value)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return dict(_fields(value, "")) if dataclasses.is_dataclass(value) else value


def write_topic(table: pd.DataFrame, path: Path, parquet: bool = False) -> Path:
    """Write a table of `read_topic`: as Parquet with lists, or as CSV with arrays as JSON.

    Raises:
        ModuleNotFoundError: Parquet is wanted and pyarrow is not installed.
        OSError: The file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if parquet and find_spec("pyarrow") is None:
        raise ModuleNotFoundError("Parquet files need pyarrow: pip install pyarrow", name="pyarrow")
    if parquet:
        table.to_parquet(path, index=False, compression="zstd")
        return path
    lists = [str(name) for name in table if table[name].map(lambda value: isinstance(value, list)).any()]
    table.assign(**{name: table[name].map(json.dumps) for name in lists}).to_csv(
        path, index=False, float_format="%.17g"
    )
    return path
