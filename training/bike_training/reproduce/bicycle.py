"""The experiments of the bicycle paper (Weyrer et al. 2026, Sects. 5.1 to 5.5) and the rides of its controllers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bike_policy.contract.bundle import Bundle, load_bundle
from bike_policy.contract.observation import rows_of
from bike_policy.riders.base import LearnedRider, Rider
from bike_policy.riders.rider import make_rider
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
from bike_training.learning.presets import load_preset
from bike_training.learning.progress import stored_actor
from bike_training.reproduce.bicycle_results import NO_SEED, PAPER, STATEMENTS, TABLES, controller_1
from bike_training.reproduce.data import Tables, table
from bike_training.reproduce.figures import BICYCLE_FIGURES
from bike_training.reproduce.paper import Advance, Experiment, Paper, Rows, learned
from bike_training.rollout.evaluation import SPEEDS, evaluate
from bike_training.rollout.rollout import ride_through, rollout, time_for
from bike_training.tasks.path import DISTANCE_THRESHOLD

TABLE_5: Final = ("prop", "alt1", "alt2", "alt3", "alt4", "alt5")
MORE: Final[Mapping[str, tuple[str, Mapping[str, Any]]]] = {
    "alt2-plain": ("alt2", {"learner.precondition": False}),
    "steady": ("alt5", {"task.weights": {"path_linear": 0.5, "steady": 0.5}}),
    **{
        name: (
            "paper",
            {"learner": name, "learner.precondition": False, "learner.averaging": 0.0}
            | dict.fromkeys(("learner.learning_rate", "learner.final_learning_rate"), rate),
        )
        for name, rate in (("ppo", 3e-4), ("a2c", 7e-4))
    },
}
"""Settings beside Table 5 with their presets and what differs: alt(2) without the coordinates that turn a preview by
distance into lean; alt(5) with the rate of the roll (Sect. 6); PPO and A2C in place of SAC (Sect. 5.1), at the learning
rates of Stable-Baselines3."""
EXPLAINED: Final = "prop"
"""Setting all of whose controllers are explained."""
SETTINGS: Final = (*TABLE_5, *MORE)
JUNCTION: Final = "junction"
JUNCTION_SPEED: Final = 4.0
"""Course and speed of Fig. 11, m/s."""
VEHICLE: Final = "whipple"

COURSE: Final = "benchmark"
SPEED: Final = 4.0
"""Course and speed of the ride of Sects. 5.4 and 5.5, m/s."""
SECTION: Final = "slalom"
"""Section of the course whose observations Fig. 14 shows."""
PATHS, PATH_LENGTH, IN_A_ROW = 10_000, 120.0, 5
"""Sect. 6: paths that are drawn, their length (m), and bends to one side that make a full circle."""
SHIPPED: Final = "whipple"
"""Actor that is explained beside controller 1 of prop."""
CLOSELY: Final = ("prop", "alt3")
"""Settings whose controllers 1 ride the junction; that of prop is looked at further."""
_INSTANT_EVERY: Final = 2
_STEP_TIME, _STEP_EVERY = 1.5, 10
"""Duration of the step response, s, and integration steps of 1 ms between its rows."""

OWN_MEANS: Final[dict[str, Any]] = {
    "learner.precondition": True,
    "learner.temperature": 0.02,
    "learner.learning_rate": 1e-3,
    "learner.final_learning_rate": 1e-3,
    "learner.policy_delay": 2,
    "learner.updates": 4,
}
"""Differences of the learner to that of the default preset.

With that one alone a run of *prop.* was in part 1 after 125,000 steps, its error no longer falling (0.5 m): inputs
of hundreds hide those of a tenth, and at a rate of 3e-4 a temperature of 1 takes some 18,000 updates to fall to 0.005.
"""


@dataclass(frozen=True, kw_only=True)
class BicycleExperiment(Experiment):
    """Settings of the experiments.

    Attributes:
        settings: of Table 5, or of `MORE`, by name.
        steps: n_tot.
        speeds: that controllers ride at, m/s.
        longest: longest ride, s.
        learner: settings of the learner, as entries of a sweep; observation, reward, curriculum and thresholds are the
            paper's.
        which: the actor of a run that is its controller: ``latest_success`` as in Sect. 5.3.1, or ``averaged`` for the
            last one.
        explained: observations of the slalom that SHAP values are computed of.
        permutations: orders in which their features are put in.
        paths: random paths that are searched for full circles.
    """

    title: str = "bicycle paper"
    settings: tuple[str, ...] = SETTINGS
    steps: int = 4_000_000
    speeds: tuple[float, ...] = SPEEDS
    longest: float = 1e4
    learner: tuple[tuple[str, Any], ...] = ()
    which: str = "latest_success"
    explained: int = 100
    permutations: int = 10
    paths: int = PATHS

    def base(self) -> dict[str, Any]:
        """Return the entries of every run."""
        learner = dict(self.learner) or fast_means()
        return {"vehicle": VEHICLE, "steps": self.steps, "set": learner}

    def entries(self, setting: str) -> dict[str, Any]:
        """Return the entries of the runs of a setting."""
        _, changes = MORE.get(setting, ("", {}))
        return {"preset": preset_of(setting), **({"set": dict(changes)} if changes else {})}


QUICK: Final = BicycleExperiment(
    settings=("prop",),
    seeds=(0,),
    steps=400,
    speeds=(4.0, 5.0),
    longest=4.0,
    learner=(
        ("learner", "sb3"),
        ("learner.layers", [8]),
        ("learner.batch_size", 16),
        ("learner.buffer_size", 2000),
        ("learner.learning_starts", 20),
        ("learner.environments", 2),
        ("curriculum.validate_every", 40),
    ),
    which="averaged",
    explained=4,
    permutations=1,
    paths=200,
)
"""Tries the whole way in seconds; it learns nothing."""


def fast_means() -> dict[str, Any]:
    """Return the differences of the learner to the published one, as entries of a sweep.

    It is that of the default preset, with `OWN_MEANS` for what the paper's observation and reward ask for.
    """
    fast, published = (load_preset(name).to_plain()["learner"] for name in ("fast", "paper"))
    differing = {name: value for name, value in fast.items() if value != published[name] and name != "steps"}
    kind = differing.pop("learner")
    return {"learner": kind, **{f"learner.{name}": value for name, value in differing.items()}, **OWN_MEANS}


def preset_of(setting: str) -> str:
    """Return the preset of a setting."""
    return MORE[setting][0] if setting in MORE else "paper" if setting == "prop" else setting


def controller(folder: Path, setting: str, which: str) -> Bundle | None:
    """Return the controller that a run deploys; None where it has none.

    In the paper a run that has not ended its curriculum has none: two of alt(5) ride (Sect. 5.3.1).

    Args:
        folder: of the run.
        setting: its name.
        which: as in `BicycleExperiment`.
    """
    with learned(folder) as progress:
        if progress is None or (which == "latest_success" and progress["curriculum"]["finished_at"] is None):
            return None
        actor = stored_actor(progress, which)
    if actor is None:
        return None
    task = load_preset(preset_of(setting)).task
    vehicle = load_vehicle(VEHICLE)
    return Bundle(setting, actor, task.layout, task.action, vehicle.name, vehicle.control_period)


def ride(folder: Path, setting: str, seed: int, experiment: BicycleExperiment, advance: Advance) -> Rows | None:
    """Ride the controller of a run at all speeds on the benchmark path and on random paths (Sects. 5.3.2 and 5.3.3).

    Those of `EXPLAINED` ride the slalom of Sect. 5.5 as well.
    """
    bundle = controller(folder, setting, experiment.which)
    if bundle is None:
        return None
    client, rider = _simulator(), LearnedRider(bundle)
    try:
        figures = evaluate(
            lambda request, longest: ride_through(client, rider, request, min(longest, experiment.longest)),
            speeds=experiment.speeds,
            tick=advance,
        )
    finally:
        client.close()
    rows = [
        (setting, seed, course, ride["speed_m_s"], ride["completed"], ride["mean_m"], ride["max_m"])
        for course, key in (("benchmark", "rides"), ("random", "random"))
        for ride in figures[key]
    ]
    shares: list[Any] = []
    if setting == EXPLAINED:
        ridden = ride_course(LearnedRider(bundle), COURSE, SPEED, experiment.longest)
        shares = impacts(setting, seed, bundle, ridden, experiment.explained, experiment.permutations)
    return {"rides": rows, "impacts": shares}


def _simulator() -> Simulator:
    return Simulator(SimulatorConfig(engine=COMPILED_ENGINE, time_step=0.01))


def ride_course(rider: Rider, course: str, speed: float, longest: float = math.inf) -> list[Snapshot]:
    """Ride a course and return all snapshots up to its end, a fall, or a time.

    Args:
        rider: that rides.
        course: its name.
        speed: m/s.
        longest: longest time, s.
    """
    longest = min(longest, time_for(load_course(course), speed))
    request = ResetRequest(course=course, speed_range=(speed,) * 2)
    if rider.preview is not None:
        request = replace(request, preview=rider.preview)
    client, snapshots = _simulator(), []
    try:
        for snapshot in rollout(client, rider, request):
            snapshots.append(snapshot)
            if snapshot.fallen or snapshot.finished or snapshot.off_course or snapshot.time >= longest:
                break
    finally:
        client.close()
    return snapshots


def ride_junction(riders: Sequence[tuple[str, Rider]]) -> list[Any]:
    """Ride the road junction of Fig. 11 with each named rider and return the tracks of both contact points."""
    rows = []
    for name, rider in riders:
        ridden = ride_course(rider, JUNCTION, JUNCTION_SPEED)
        for snapshot in ridden:
            state, look = snapshot.state, snapshot.look
            errors = look[[lk.LATERAL_ERROR, lk.FRONT_LATERAL_ERROR]]
            places = *state[[st.X, st.Y]], *look[[lk.FRONT_X, lk.FRONT_Y]]
            rows.append((name, snapshot.time, *places, *errors, ridden[-1].finished))
    return rows


def instants(ride: Sequence[Snapshot]) -> list[Any]:
    """Return every second instant of a ride."""
    return [
        (
            each.look[lk.PROGRESS],
            *each.state[[st.X, st.Y]],
            *each.look[[lk.FRONT_X, lk.FRONT_Y]],
            *each.state[[st.ROLL, st.STEER]],
            each.look[lk.CURVATURE],
        )
        for each in ride[::_INSTANT_EVERY]
    ]


def impacts(
    name: str, seed: int, bundle: Bundle, ride: Sequence[Snapshot], observations: int, permutations: int
) -> list[Any]:
    """Return SHAP values of an actor on the slalom of its own ride; none where it did not come there.

    Args:
        name: its setting, or its own where it is a shipped one.
        seed: of its run, or `NO_SEED`.
        bundle: the actor.
        ride: that it rode.
        observations: how many, evenly spread over the slalom; they are the background as well.
        permutations: orders in which features are put in.
    """
    layout = bundle.layout
    course = load_course(COURSE)
    starts = [*course.sections, ("", course.length)]
    begin, end = next((one, two) for (name, one), (_, two) in itertools.pairwise(starts) if name == SECTION)
    seen = [layout.observe(rows_of(each))[0] for each in ride if begin <= each.look[lk.PROGRESS] < end]
    if len(seen) < 2:
        return []
    from bike_training.explain.shap_values import explain  # late: shap takes seconds to import

    chosen = np.unique(np.linspace(0, len(seen) - 1, min(observations, len(seen))).round().astype(int))
    found = explain(bundle, np.array(seen)[chosen], permutations=permutations, background=len(chosen), silent=True)
    return [
        (name, seed, number, feature, found.features[number, place], found.values[number, place])
        for number in range(len(chosen))
        for place, feature in enumerate(layout.names)
    ]


def front_directions() -> list[Any]:
    """Return Table 8, by the formula and measured by rolling in both engines."""
    vehicle = load_vehicle("whipple")
    engines = {kind: make_bicycle_engine(kind, replace(vehicle, g=0.0), 0.001) for kind in ("whipple", "pybullet")}
    rows = []
    for roll, steer, published in validation.TABLE_8:
        posture = math.radians(roll), math.radians(steer)
        formula = kinematics.front_direction(*posture, vehicle.parameters)
        rolled = {kind: validation.front_direction(engine, *posture) for kind, engine in engines.items()}
        found = (math.degrees(each) for each in (formula, rolled["whipple"], rolled["pybullet"]))
        rows.append((roll, steer, published, *found))
    for engine in engines.values():
        engine.close()
    return rows


def steering_step() -> list[Any]:
    """Return the step response of Fig. 16: 70 degrees from standstill, without gravity."""
    target = math.radians(70.0)
    vehicle = replace(load_vehicle("whipple"), g=0.0)

    def response(engine: BicycleEngine) -> NDArray[np.float64]:
        try:
            return np.degrees(validation.steering_step(engine, target, _STEP_TIME))
        finally:
            engine.close()

    whipple, pybullet = (response(make_bicycle_engine(kind, vehicle, 0.001)) for kind in ("whipple", "pybullet"))
    later = range(_STEP_EVERY - 1, len(whipple), _STEP_EVERY)
    return [(0.0, 0.0, 0.0), *((1e-3 * (k + 1), whipple[k], pybullet[k]) for k in later)]


def full_circles(paths: int) -> int:
    """Draw paths of the last part of the curriculum and count those with a full circle."""
    rng = np.random.default_rng(0)

    def has_circle(elements: Sequence[Element]) -> bool:
        turns = [np.sign(element.angle) if isinstance(element, Arc) else 0.0 for element in elements]
        same = (len(list(bends)) for turn, bends in itertools.groupby(turns) if turn)
        return max(same, default=0) >= IN_A_ROW

    drawn = (random_elements(rng, CURRICULUM_PATHS[-1], PATH_LENGTH) for _ in range(paths))
    return sum(has_circle(elements) for elements in drawn)


def add_details(data: Tables, folders: Mapping[tuple[str, int], Path], experiment: BicycleExperiment) -> Tables:
    """Return the tables with those of Figs. 11 to 14 and 16, Table 8 and Sect. 6.

    Args:
        data: of runs and rides.
        folders: of the runs whose controllers rode, by setting and seed.
        experiment: its settings.
    """
    chosen = [(name, controller_1(data, name)) for name in CLOSELY]
    bundles = {
        name: controller(folders[name, seed], name, experiment.which) for name, seed in chosen if seed is not None
    }
    best = {name: bundle for name, bundle in bundles.items() if bundle is not None}
    riders = [(name, LearnedRider(bundle)) for name, bundle in best.items()]
    shipped = load_bundle(SHIPPED)
    slalom = ride_course(LearnedRider(shipped), COURSE, SPEED, experiment.longest)
    shares = impacts(SHIPPED, NO_SEED, shipped, slalom, experiment.explained, experiment.permutations)
    closely = ride_course(LearnedRider(best[EXPLAINED]), COURSE, SPEED, experiment.longest) if EXPLAINED in best else []
    rows = {
        "tracks": ride_junction([*riders, *((name, make_rider(name)) for name in ("stanley", "lqr"))]),
        "ride": instants(closely),
        "directions": front_directions(),
        "steering": steering_step(),
        "chances": [(experiment.paths, PATH_LENGTH, full_circles(experiment.paths))],
    }
    found = {name: table(PAPER, name, each) for name, each in rows.items()}
    return data | found | {"impacts": pd.concat([data["impacts"], table(PAPER, "impacts", shares)], ignore_index=True)}


BICYCLE: Final[Paper[BicycleExperiment]] = Paper(
    name="bicycle",
    file=PAPER,
    experiment=BicycleExperiment(),
    quick=QUICK,
    error="mean_error_m",
    unit=DISTANCE_THRESHOLD,
    ridden=("rides", "impacts"),
    rides=lambda experiment: 2 * len(experiment.speeds),
    ride=ride,
    add_details=add_details,
    statements=STATEMENTS,
    figures=BICYCLE_FIGURES,
    written=TABLES,
    counts=lambda data: {"rides": len(data["rides"]), "rides_completed": int(data["rides"]["completed"].sum())},
)
