"""Observations of a policy on a recorded ride: states and previews of a section through the policy's own layout."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_analysis import Ride, find_rides, read_recording
from bike_analysis.read.columns import ColumnReader
from bike_analysis.read.container import find_files
from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import ObservationLayout, Rows
from bike_sim.physics.state import FIELDS
from bike_sim.sim import look as lk
from bike_training.replay.recorded_rides import blocks_of

FloatArray = NDArray[np.float64]

WHOLE_RIDE: Final = "all"
"""Name of the section that is all of a ride."""

_PREVIEW_FIELDS: Final = ("preview_by_time", "preview_interval", "preview_y")


@dataclass(frozen=True)
class RecordedObservations:
    """Observations of one section of a recorded ride, one a state that was to be answered.

    Attributes:
        recording: the file.
        course: name of the course; empty where it was not recorded.
        section: name of the section, or WHOLE_RIDE.
        speed: forward speed, m/s, shape (n,).
        observations: through the policy's layout, shape (n, size).
        steering: recorded steering command that answered each state, in [-1, 1], shape (n,); NaN where none was.
        steering_limit: set point of the steering angle for a command of 1, rad.
    """

    recording: Path
    course: str
    section: str
    speed: FloatArray
    observations: NDArray[np.float32]
    steering: FloatArray
    steering_limit: float


def policy_of(notes: dict[str, str], recording: Path) -> str:
    """Return the policy that drove, as the recorder noted it.

    Raises:
        ValueError: it was not noted.
    """
    if not notes.get("policy"):
        raise ValueError(f"{recording} does not say which policy drove; name it with --policy")
    return notes["policy"]


def read_observations(path: Path, bundle: Bundle, section: str, number: int = 1) -> RecordedObservations:
    """Return the observations of a policy, real or hypothetical, on a section of a recorded ride.

    Args:
        path: recording.
        bundle: policy.
        section: name of a section of the course, or WHOLE_RIDE.
        number: which ride of the recording, from 1.

    Raises:
        FileNotFoundError: there is no such recording.
        ValueError: it is no recording of a ride, has no such ride or section, or shows what this policy cannot use.
    """
    recording = read_recording(path)
    rides = find_rides(recording)
    if not 1 <= number <= len(rides):
        raise ValueError(f"{recording.path} has {len(rides)} ride(s), there is no ride {number}")
    ride = rides[number - 1]
    bundle.check_fit(recording.vehicle, float(ride.states.control_period[0]))
    rows = np.flatnonzero(rows_of(ride, section, recording.path) & ~ride.states.fallen)
    if len(rows) < 2:
        raise ValueError(
            f"{recording.path}: section {section!r} of ride {number} has {len(rows)} states, at least 2 needed"
        )
    states = ride.states.take(rows)
    columns = _columns(path, f"{recording.namespace}/state", states.order)
    commands = dict(zip(ride.commands.step.tolist(), ride.commands.steering.tolist(), strict=True))
    return RecordedObservations(
        recording=recording.path,
        course=ride.course.name if ride.course else "",
        section=section,
        speed=states.speed,
        observations=_observe(bundle, columns),
        steering=np.array([commands.get(step, np.nan) for step in states.step.tolist()]),
        steering_limit=float(states.steering_limit[0]),
    )


def rows_of(ride: Ride, section: str, path: Path) -> NDArray[np.bool_]:
    """Return which states of a ride are in a section.

    Args:
        ride: of a recording.
        section: name of a section of its course, or WHOLE_RIDE.
        path: of the recording, for messages.

    Raises:
        ValueError: the course has no such section.
    """
    if section == WHOLE_RIDE:
        return np.ones(len(ride.states), dtype=bool)
    course = ride.course
    if course is None or section not in course.section_names:
        known = [*dict.fromkeys(course.section_names if course else ()), WHOLE_RIDE]
        raise ValueError(f"{path}: its course has no section {section!r}; there is {', '.join(known)}")
    places = [place for place, name in enumerate(course.section_names) if name == section]
    return np.isin(ride.section_of(), places)


def _columns(path: Path, topic: str, orders: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Read minimal states and previews of the messages at given indices of a recording."""
    reader: ColumnReader | None = None
    for _, kind, block, rows, before in blocks_of(find_files(path), {topic}):
        rows = rows[np.isin(before + block.first + rows, orders)]
        if not len(rows):
            continue
        if reader is None:
            missing = {*FIELDS, *lk.FIELDS, *_PREVIEW_FIELDS} - kind.fields()
            if missing:
                raise ValueError(f"{path}: {topic} has no {', '.join(sorted(missing))}, which observations are made of")
            reader = ColumnReader(kind, (*FIELDS, *lk.FIELDS, *_PREVIEW_FIELDS))
        reader.add_block(block.contents, block.begin[rows], block.end[rows])
    assert reader is not None, "the orders are those of messages that have been read"
    return reader.finish()


def path_layout(bundle: Bundle) -> ObservationLayout:
    """Return the layout of a policy that follows paths.

    Raises:
        ValueError: it races; what it sees is not made of one state.
    """
    if bundle.layout.races:
        raise ValueError(f"policy {bundle.name!r} races; only policies that follow paths can be explained so far")
    return bundle.layout


def _observe(bundle: Bundle, columns: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
    layout, preview = path_layout(bundle), columns["preview_y"]
    picked = layout.pick_preview(
        bool(columns["preview_by_time"][0]), float(columns["preview_interval"][0]), preview.shape[1]
    )
    state, look = (np.stack([columns[name] for name in names], axis=1) for names in (FIELDS, lk.FIELDS))
    observations = layout.observe(Rows.of_path(state, look, preview[:, picked]))
    if not np.isfinite(observations).all():
        raise ValueError("the recorded states hold values that are not finite")
    return observations
