"""The messages of a recording's files, sorted by topic: columns where all messages are alike, else one by one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis.read.columns import ColumnReader, MessageSchema, SchemaError
from bike_analysis.read.container import Block, Container
from bike_analysis.read.files import RecordingFiles
from bike_analysis.read.messages import DECODED_BY_MESSAGE
from bike_analysis.read.motion import MOTION_TYPES
from bike_analysis.read.tables import COLUMNS, STATE_TYPE, Floats, Integers

LARGEST_DEFINITION: Final = 256 * 1024
"""Longer definitions of a type are not parsed, bytes. That of our states has six thousand."""

_STAMP: Final = ("header.stamp.sec", "header.stamp.nanosec")


@dataclass
class TopicReader:
    """Columns of one topic while they are being collected.

    Attributes:
        type_name: Type of its messages.
        columns: Reader of the wanted fields that were recorded.
        missing: Wanted fields that were not.
        orders: Places of messages in the recording, block by block.
        log_times: Their log times, ns.
    """

    type_name: str
    columns: ColumnReader
    missing: tuple[str, ...]
    orders: list[Integers] = field(default_factory=list)
    log_times: list[Integers] = field(default_factory=list)

    @classmethod
    def of(cls, schema: MessageSchema) -> TopicReader:
        """A reader of the columns that are wanted and recorded.

        Raises:
            SchemaError: If the type has none of them, or its definition cannot be understood.
        """
        wanted, available = COLUMNS[schema.name], schema.scalars()
        found = [name for name in (*_STAMP, *wanted) if name in available]
        if not set(found) & set(wanted):
            raise SchemaError(f"{schema.name} as recorded has none of the known fields; is it another version?")
        missing = tuple(name for name in wanted if name not in available)
        return cls(schema.name, ColumnReader(schema, found), missing)

    def add(self, block: Block, rows: Integers) -> None:
        """Take messages of a block; those that do not fit their type are left out."""
        good = rows[self.columns.add_block(block.contents, block.begin[rows], block.end[rows])]
        self.orders.append(good + block.first)
        self.log_times.append(block.log_time_ns[good])

    def finish(self) -> tuple[Integers, Floats, dict[str, NDArray[Any]]]:
        """Places in the recording, times in s and the columns by field."""
        columns = self.columns.finish()
        order, log_time = np.concatenate(self.orders), np.concatenate(self.log_times)
        stamp = [columns.pop(name, None) for name in _STAMP]
        log_time_s: Floats = np.asarray(1e-9 * log_time, dtype=np.float64)
        if stamp[0] is None or stamp[1] is None:
            return order, log_time_s, columns
        time_s: Floats = np.asarray(stamp[0] + 1e-9 * stamp[1], dtype=np.float64)
        if self.type_name in MOTION_TYPES:
            time_s = _with_unknown_times(time_s, log_time_s)
        return order, time_s, columns


def _with_unknown_times(time_s: Floats, log_time_s: Floats) -> Floats:
    """Stamps where those that are 0, which is what nodes write that do not know the time, come from the log times.

    The log time may be of another clock. So only its distance from the next message with a stamp counts, where there is
    one.
    """
    unknown, known = np.flatnonzero(time_s == 0.0), np.flatnonzero(time_s)
    if not len(known):
        return log_time_s
    near = known[np.minimum(np.searchsorted(known, unknown), len(known) - 1)]
    times = time_s.copy()
    times[unknown] = time_s[near] + (log_time_s[unknown] - log_time_s[near])
    return times


class MessageSorter:
    """Sorts the messages of a recording's files.

    Attributes:
        containers: The files.
        topics: Columns by topic.
        others: Messages that are decoded one by one, with their places in the recording, by topic.
        vehicles: Name of the vehicle in the first state, by topic.
        counts: Messages read, by topic.
        message_count: Messages read, of all topics.
        warnings: What was missing or wrong, one sentence each.
    """

    def __init__(self, found: RecordingFiles) -> None:
        """Read all files of a recording."""
        self.containers = [Container(file) for file in found.files]
        self.topics: dict[str, TopicReader] = {}
        self.others: dict[str, list[tuple[int, Any]]] = {}
        self.vehicles: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        self.message_count = 0
        self.warnings: list[str] = list(found.warnings)
        for box in self.containers:
            self._read_file(box)

    def _read_file(self, box: Container) -> None:
        schemas: dict[int, MessageSchema | None] = {}
        before = self.message_count
        for block in box.blocks():
            block = replace(block, first=block.first + before)
            for channel_id in np.unique(block.channel).tolist():
                if channel_id not in schemas:
                    schemas[channel_id] = self._make_schema(box, channel_id)
                schema = schemas[channel_id]
                if schema is not None:
                    rows = np.flatnonzero(block.channel == channel_id)
                    self._add(box.channels[channel_id].topic, schema, block, rows)
            self.message_count += len(block)
        self._tell(box)

    def _tell(self, box: Container) -> None:
        """Count the messages of a file, and warn of its faults."""
        for channel_id, count in box.counts.items():
            if channel_id in box.channels:
                topic = box.channels[channel_id].topic
                self.counts[topic] = self.counts.get(topic, 0) + count
            else:
                self.warn(f"{count} messages are skipped: the file does not say what channel {channel_id} is")
        of = f" of {box.path.name}" if len(self.containers) > 1 else ""
        if box.damaged_chunks:
            many = "part is" if box.damaged_chunks == 1 else "parts are"
            self.warn(f"{box.damaged_chunks} {many}{of} damaged and left out: {box.damage}", first=True)
        if box.truncated:
            torn = box.path.name if of else "the recording"
            self.warn(f"{torn} is torn: {box.reason}; read up to its last whole chunk", first=True)

    def _add(self, topic: str, schema: MessageSchema, block: Block, rows: Integers) -> None:
        """Sort messages of one topic in; those that do not fit their type are left out with a warning."""
        if schema.name in COLUMNS:
            reader = self.topics.get(topic)
            if reader is None:
                try:
                    reader = self.topics[topic] = TopicReader.of(schema)
                except SchemaError as error:
                    self.warn(f"topic {topic} is skipped: {error}")
                    return
                self.vehicles[topic] = self._vehicle(schema, block.data(int(rows[0])))
            if reader.type_name == schema.name:
                reader.add(block, rows)
                if reader.columns.damage:
                    self.warn(f"topic {topic}: messages are left out: {reader.columns.damage}")
            return
        for row in rows.tolist():
            try:
                self.others.setdefault(topic, []).append((block.first + row, schema.decode(block.data(row))))
            except SchemaError as error:
                self.warn(f"topic {topic}: messages are left out: {error}")

    @staticmethod
    def _vehicle(schema: MessageSchema, data: bytes) -> str:
        if schema.name != STATE_TYPE:
            return ""
        try:
            return str(getattr(schema.decode(data), "vehicle", ""))
        except SchemaError:
            return ""

    def _make_schema(self, box: Container, channel_id: int) -> MessageSchema | None:
        """Schema of a channel that is worth decoding, else None."""
        channel = box.channels.get(channel_id)
        schema = box.schemas.get(channel.schema_id) if channel else None
        if channel is None or schema is None:
            return None
        if schema.name not in COLUMNS and schema.name not in DECODED_BY_MESSAGE:
            return None
        if channel.message_encoding != "cdr" or schema.encoding != "ros2msg":
            self.warn(f"topic {channel.topic} is skipped: it is {channel.message_encoding} by {schema.encoding}")
            return None
        if len(schema.data) > LARGEST_DEFINITION:
            self.warn(f"topic {channel.topic} is skipped: the definition of its type has {len(schema.data)} bytes")
            return None
        try:
            return MessageSchema(schema.name, schema.data.decode("utf-8", errors="replace"))
        except SchemaError as error:
            self.warn(f"topic {channel.topic} is skipped: {error}")
            return None

    def warn(self, text: str, first: bool = False) -> None:
        """Note a sentence, once."""
        one_line = " ".join(text.split())
        if one_line not in self.warnings:
            self.warnings.insert(0 if first else len(self.warnings), one_line)
