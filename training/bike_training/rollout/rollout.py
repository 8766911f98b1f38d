"""Rides of a rider: the only loop of rider and simulator, in process or through ROS, and records of rides on courses.

Evaluation, validation, laps, replay and recordings take their snapshots from here.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.observation import rows_of
from bike_policy.riders.base import Rider
from bike_sim.course.course import Course
from bike_sim.course.finish import Finish, up_to_finish
from bike_sim.physics.state import ROLL, STEER, STEER_RATE, X, Y
from bike_sim.sim import look as lk
from bike_sim.sim.request import RANDOM_COURSE, ResetRequest
from bike_sim.sim.snapshot import Snapshot
from bike_training.envs.clients import Client
from bike_training.tasks.path import PROP


def rollout(
    client: Client, rider: Rider, request: ResetRequest, times: list[float] | None = None
) -> Iterator[Snapshot]:
    """Begin an episode and ride it step by step, as long as the caller takes snapshots.

    Args:
        client: simulator.
        rider: answers each snapshot with a command.
        request: of the episode.
        times: takes the processor time of each answer of the rider, s; None where nobody wants to know.

    Yields:
        Each snapshot, from the one of the reset on. It ends after a fall and where the rider has no answer.

    Raises:
        ValueError: the request or the rider does not fit the simulator.
    """
    snapshot = client.reset(request)
    course = client.course
    assert course is not None, "an episode has begun"
    rider.begin(client.vehicle, course, client.config.control_period, client.preview)
    yield snapshot
    while not snapshot.fallen:
        began = time.thread_time()  # processor time: other work on the machine does not count
        command = rider.command(snapshot)
        if times is not None:
            times.append(time.thread_time() - began)
        if command is None:
            return
        snapshot = client.step(*command)
        yield snapshot


FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RideResult:
    """One ride from its first state to its last, or to the finish of an open course.

    Attributes:
        speed: forward speed at the start, m/s.
        completed: it reached its end without falling or leaving the course.
        progress: arc length, m, shape (steps + 1,).
        error: signed distance of the rear contact to the course, m.
        roll: rad.
        steer: rad.
        steer_rate: rad/s.
    """

    speed: float
    completed: bool
    progress: FloatArray
    error: FloatArray
    roll: FloatArray
    steer: FloatArray
    steer_rate: FloatArray

    @classmethod
    def from_snapshots(cls, snapshots: Sequence[Snapshot], course: Course, completed: bool) -> RideResult:
        """Collect the record from snapshots; a ride is evaluated up to the finish of an open course."""
        looks = np.array([snapshot.look for snapshot in snapshots])
        states = np.array([snapshot.state for snapshot in snapshots])
        progress, error, _, _, roll, steer, steer_rate = up_to_finish(
            Finish.of(course),
            looks[:, lk.PROGRESS],
            looks[:, lk.LATERAL_ERROR],
            *(states[:, place] for place in (X, Y, ROLL, STEER, STEER_RATE)),
        )
        return cls(float(looks[0, lk.SPEED]), completed, progress, error, roll, steer, steer_rate)

    def figures(self, sections: Iterable[tuple[str, float]] = ()) -> dict[str, Any]:
        """Return mean, maximum and RMS distance, also for each section (name, first arc length in m)."""
        distance = np.abs(self.error)
        found: dict[str, Any] = {
            "speed_m_s": round(self.speed, 6),
            "completed": self.completed,
            "mean_m": float(distance.mean()),
            "max_m": float(distance.max()),
            "rms_m": float(np.sqrt(np.mean(distance**2))),
            "max_roll_deg": float(np.degrees(np.abs(self.roll).max())),
            "max_steer_deg": float(np.degrees(np.abs(self.steer).max())),
            "steer_rate_rms_deg_s": float(np.degrees(np.sqrt(np.mean(self.steer_rate**2)))),
        }
        bounds = [*sections, ("", np.inf)]
        per_section = []
        for (name, first), (_, last) in pairwise(bounds):
            inside = distance[(self.progress >= first) & (self.progress < last)]
            if len(inside):
                per_section.append({"section": name, "mean_m": float(inside.mean()), "max_m": float(inside.max())})
        if per_section:
            found["sections"] = per_section
        return found


def ride_through(
    client: Client, rider: Rider, request: ResetRequest, longest: float, times: list[float] | None = None
) -> RideResult:
    """Ride until the course ends, the ride fails, or the time is up.

    Args:
        client: simulator.
        rider: whose preview replaces that of the request if it needs one.
        request: of the ride.
        longest: longest ride, s; an open ride that lasts so long is completed, a closed one is not.
        times: see `rollout`.
    """
    request = with_preview(request, rider)
    snapshots = []
    for snapshot in rollout(client, rider, request, times):
        snapshots.append(snapshot)
        if is_over(snapshot, longest):
            break
    assert client.course is not None
    return RideResult.from_snapshots(snapshots, client.course, is_completed(snapshots[-1], request))


def with_preview(request: ResetRequest, rider: Rider) -> ResetRequest:
    """Return a request with the preview that a rider needs, if it needs one."""
    return request if rider.preview is None else replace(request, preview=rider.preview)


def is_over(snapshot: Snapshot, longest: float) -> bool:
    """Return whether a ride ends with a snapshot: failed, at the end of the course, or out of time (s)."""
    return _has_failed(snapshot) or snapshot.finished or snapshot.time > longest - 1e-9


def _has_failed(snapshot: Snapshot) -> bool:
    return bool(PROP.failed(rows_of(snapshot))[0])


def is_completed(last: Snapshot, request: ResetRequest) -> bool:
    """Return whether a ride that ended with a snapshot is completed.

    A course must be ridden to its end; on a random path it is enough to have lasted.
    """
    return not _has_failed(last) and (last.finished or request.course == RANDOM_COURSE)


def time_for(course: Course, speed: float) -> float:
    """Return a generous time limit for a course, s."""
    return 1.5 * course.length / speed + 5.0
