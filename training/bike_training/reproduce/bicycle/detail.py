"""What the paper looks at closely: a ride, what moves the actor, the drive, and how rare full circles are."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle
from bike_policy.contract.observation import rows_of
from bike_policy.riders.rider import LearnedRider
from bike_sim.course.course import Course
from bike_sim.course.elements import Arc, Element
from bike_sim.course.files import load_course
from bike_sim.course.random_courses import CURRICULUM_PATHS, random_elements
from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.engine import BicycleEngine
from bike_sim.physics.engines import make_bicycle_engine
from bike_sim.sim import look as lk
from bike_sim.sim.batch import COMPILED_ENGINE
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.sim.snapshot import Snapshot
from bike_sim.validation import bicycle as validation
from bike_sim.vehicles.files import load_vehicle
from bike_training.reproduce.bicycle.data import Chance, Direction, Impact, Instant, SteeringStep
from bike_training.rollout.rollout import rollout, time_for

COURSE: Final = "benchmark"
SPEED: Final = 4.0
"""Of the ride of Sects. 5.4 and 5.5, m/s."""
SECTION: Final = "slalom"
"""Where observations are taken for Fig. 14."""
PATHS, PATH_LENGTH, IN_A_ROW = 10_000, 120.0, 5
"""Sect. 6: paths that are drawn, their length (m), and bends to one side that make a full circle."""
_INSTANT_EVERY: Final = 2
_STEP_TIME, _STEP_EVERY = 1.5, 10
"""Duration of the step response, s, and integration steps of 1 ms between its rows."""


def ride_benchmark(bundle: Bundle, longest: float) -> list[Snapshot]:
    """Ride the benchmark path at 4 m/s, at most for some seconds, and return all snapshots up to its end or a fall."""
    client = Simulator(SimulatorConfig(engine=COMPILED_ENGINE, time_step=0.01))
    rider = LearnedRider(bundle)
    assert rider.preview is not None, "it follows paths"
    longest = min(longest, time_for(load_course(COURSE), SPEED))
    request = ResetRequest(course=COURSE, speed_range=(SPEED,) * 2, preview=rider.preview)
    ride = []
    try:
        for snapshot in rollout(client, rider, request):
            ride.append(snapshot)
            if snapshot.fallen or snapshot.finished or snapshot.off_course or snapshot.time >= longest:
                break
    finally:
        client.close()
    return ride


def instants(ride: Sequence[Snapshot]) -> list[Instant]:
    """Return every second instant of a ride."""
    rows = []
    for snapshot in ride[::_INSTANT_EVERY]:
        state, look = snapshot.state, snapshot.look
        places = (look[lk.PROGRESS], state[st.X], state[st.Y], look[lk.FRONT_X], look[lk.FRONT_Y])
        angles = (state[st.ROLL], state[st.STEER], look[lk.CURVATURE])
        rows.append(Instant(*map(float, (*places, *angles))))
    return rows


def impacts(
    policy: str, bundle: Bundle, ride: Sequence[Snapshot], observations: int, permutations: int
) -> list[Impact]:
    """Return SHAP values of an actor on the slalom of its own ride; none where it did not come there.

    Args:
        policy: its name in the table.
        bundle: the actor.
        ride: that it rode.
        observations: how many, evenly spread over the slalom; they are the background as well.
        permutations: orders in which features are put in.
    """
    layout = bundle.layout
    begin, end = _section(load_course(COURSE), SECTION)
    seen = [layout.observe(rows_of(each))[0] for each in ride if begin <= each.look[lk.PROGRESS] < end]
    if len(seen) < 2:
        return []
    from bike_training.explain.shap_values import explain  # late: shap takes seconds to import

    chosen = np.unique(np.linspace(0, len(seen) - 1, min(observations, len(seen))).round().astype(int))
    found = explain(
        bundle, np.array(seen)[chosen], permutations=permutations, background=len(chosen), silent=True
    )  # fmt: skip
    return [
        Impact(policy, number, name, float(found.features[number, place]), float(found.values[number, place]))
        for number in range(len(chosen))
        for place, name in enumerate(layout.names)
    ]


def _section(course: Course, name: str) -> tuple[float, float]:
    """Return where a section of a course begins and ends, m."""
    starts = [*course.sections, ("", course.length)]
    return next((begin, end) for (each, begin), (_, end) in itertools.pairwise(starts) if each == name)


def front_directions() -> list[Direction]:
    """Return Table 8, by the formula and measured by rolling in both engines."""
    vehicle = load_vehicle("whipple")
    engines = {kind: make_bicycle_engine(kind, replace(vehicle, g=0.0), 0.001) for kind in ("whipple", "pybullet")}
    rows = []
    for roll, steer, published in validation.TABLE_8:
        posture = math.radians(roll), math.radians(steer)
        formula = kinematics.front_direction(*posture, vehicle.parameters)
        rolled = {kind: validation.front_direction(engine, *posture) for kind, engine in engines.items()}
        found = (math.degrees(each) for each in (formula, rolled["whipple"], rolled["pybullet"]))
        rows.append(Direction(roll, steer, published, *found))
    for engine in engines.values():
        engine.close()
    return rows


def steering_step() -> list[SteeringStep]:
    """Return the step response of Fig. 16: 70 degrees from standstill, without gravity."""
    target = math.radians(70.0)
    vehicle = replace(load_vehicle("whipple"), g=0.0)

    def response(engine: BicycleEngine) -> NDArray[np.float64]:
        try:
            return np.degrees(validation.steering_step(engine, target, _STEP_TIME))
        finally:
            engine.close()

    whipple, pybullet = (response(make_bicycle_engine(kind, vehicle, 0.001)) for kind in ("whipple", "pybullet"))
    return [SteeringStep(0.0, 0.0, 0.0)] + [
        SteeringStep(1e-3 * (k + 1), float(whipple[k]), float(pybullet[k]))
        for k in range(_STEP_EVERY - 1, len(whipple), _STEP_EVERY)
    ]


def full_circles(paths: int) -> Chance:
    """Draw paths of the last part of the curriculum and count those with a full circle."""
    rng = np.random.default_rng(0)
    drawn = (random_elements(rng, CURRICULUM_PATHS[-1], PATH_LENGTH) for _ in range(paths))
    return Chance(paths, PATH_LENGTH, sum(_has_circle(elements) for elements in drawn))


def _has_circle(elements: Sequence[Element]) -> bool:
    turns = [np.sign(element.angle) if isinstance(element, Arc) else 0.0 for element in elements]
    runs = (len(list(same)) for turn, same in itertools.groupby(turns) if turn)
    return max(runs, default=0) >= IN_A_ROW
