"""The experiments of Weyrer et al. (2026), Sects. 5.1 to 5.5, as a sweep, and the rides of its controllers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from bike_policy.contract.bundle import Bundle
from bike_policy.riders.rider import LearnedRider, Rider, make_rider
from bike_sim.course.files import load_course
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.batch import COMPILED_ENGINE
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.vehicles.files import load_vehicle
from bike_training.learning.presets import load_preset
from bike_training.learning.progress import stored_actor
from bike_training.reproduce.bicycle.data import Rides, Track
from bike_training.reproduce.bicycle.detail import PATHS
from bike_training.reproduce.experiment import Experiment
from bike_training.rollout.evaluation import SPEEDS, evaluate
from bike_training.rollout.rollout import ride_through, rollout, time_for

SETTINGS: Final = ("prop", "alt1", "alt2", "alt3", "alt4", "alt5")
"""Names of Table 5."""
JUNCTION: Final = "junction"
JUNCTION_SPEED: Final = 4.0
"""Course and speed of Fig. 11, m/s."""
VEHICLE: Final = "whipple"

OWN_MEANS: Final[dict[str, Any]] = {
    "learner.precondition": True,
    "learner.temperature": 0.02,
    "learner.learning_rate": 1e-3,
    "learner.final_learning_rate": 1e-3,
    "learner.policy_delay": 2,
    "learner.updates": 4,
}
"""Where the learner differs from that of the default preset.

With that one alone a run of *prop.* was in part 1 after 125,000 steps, its error no longer falling (0.5 m): inputs
of hundreds hide those of a tenth, and at a rate of 3e-4 a temperature of 1 takes some 18,000 updates to fall to 0.005.
"""


@dataclass(frozen=True, kw_only=True)
class BicycleExperiment(Experiment):
    """What is done.

    Attributes:
        settings: of Table 5, by name. steps: n_tot.
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

    settings: tuple[str, ...] = SETTINGS
    steps: int = 4_000_000
    speeds: tuple[float, ...] = SPEEDS
    longest: float = 1e4
    learner: tuple[tuple[str, Any], ...] = ()
    which: str = "latest_success"
    explained: int = 100
    permutations: int = 10
    paths: int = PATHS

    @property
    def title(self) -> str:
        """Name of the sweep."""
        return "bicycle paper"

    def base(self) -> dict[str, Any]:
        """Return the entries of every run."""
        learner = dict(self.learner) or fast_means()
        return {"vehicle": VEHICLE, "steps": self.steps, "until_finished": True, "set": learner}

    def entries(self, setting: str) -> dict[str, Any]:
        """Return the entries of the runs of a setting."""
        return {"preset": preset_of(setting)}


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
    """Return where the learner differs from the published one, as entries of a sweep.

    It is that of the default preset, with `OWN_MEANS` for what the paper's observation and reward ask for.
    """
    fast, published = (load_preset(name).to_plain()["learner"] for name in ("fast", "paper"))
    differing = {name: value for name, value in fast.items() if value != published[name] and name != "steps"}
    kind = differing.pop("learner")
    return {"learner": kind, **{f"learner.{name}": value for name, value in differing.items()}, **OWN_MEANS}


def preset_of(setting: str) -> str:
    """Return the preset of a name in Table 5."""
    return "paper" if setting == "prop" else setting


def controller(folder: Path, setting: str, which: str) -> Bundle | None:
    """Return the controller that a run deploys; None where it has none.

    In the paper a run that has not ended its curriculum has none: two of alt(5) ride (Sect. 5.3.1).

    Args:
        folder: of the run.
        setting: name in Table 5.
        which: see `Experiment`.
    """
    from bike_training.learning.checkpoint import Checkpoint, find_checkpoint  # late: PyTorch takes seconds

    if find_checkpoint(folder) is None:
        return None
    checkpoint = Checkpoint(folder)
    with checkpoint.reading():
        progress = checkpoint.run["progress"]
        if which == "latest_success" and progress["curriculum"]["finished_at"] is None:
            return None
        actor = stored_actor(progress, which)
    if actor is None:
        return None
    task = load_preset(preset_of(setting)).task
    vehicle = load_vehicle(VEHICLE)
    return Bundle(setting, actor, task.layout, task.action, vehicle.name, vehicle.control_period)


def ride_all(
    bundle: Bundle, setting: str, seed: int, experiment: BicycleExperiment, tick: Callable[[], None]
) -> list[Rides]:
    """Ride a controller at all speeds on the benchmark path and on a random path each (Sects. 5.3.2 and 5.3.3)."""
    client = Simulator(SimulatorConfig(engine=COMPILED_ENGINE, time_step=0.01))
    rider = LearnedRider(bundle)
    try:
        figures = evaluate(
            lambda request, longest: ride_through(client, rider, request, min(longest, experiment.longest)),
            speeds=experiment.speeds,
            tick=tick,
        )
    finally:
        client.close()
    return [
        Rides(setting, seed, course, ride["speed_m_s"], ride["completed"], ride["mean_m"], ride["max_m"])
        for course, key in (("benchmark", "rides"), ("random", "random"))
        for ride in figures[key]
    ]


def ride_junction(riders: Sequence[tuple[str, Rider]]) -> list[Track]:
    """Ride the road junction of Fig. 11 and return the tracks of both contact points.

    Args:
        riders: with their names.
    """
    client = Simulator(SimulatorConfig(engine=COMPILED_ENGINE, time_step=0.01))
    longest = time_for(load_course(JUNCTION), JUNCTION_SPEED)
    rows = []
    for name, rider in riders:
        request = ResetRequest(course=JUNCTION, speed_range=(JUNCTION_SPEED,) * 2)
        if rider.preview is not None:
            request = replace(request, preview=rider.preview)
        ride = []
        for snapshot in rollout(client, rider, request):
            ride.append(snapshot)
            if snapshot.fallen or snapshot.finished or snapshot.off_course or snapshot.time >= longest:
                break
        for snapshot in ride:
            state, look = snapshot.state, snapshot.look
            place = (state[st.X], state[st.Y], look[lk.FRONT_X], look[lk.FRONT_Y])
            errors = (look[lk.LATERAL_ERROR], look[lk.FRONT_LATERAL_ERROR])
            time, x, y, front_x, front_y, rear, front = map(float, (snapshot.time, *place, *errors))
            rows.append(Track(name, time, x, y, front_x, front_y, rear, front, ride[-1].finished))
    client.close()
    return rows


def classical_riders() -> list[tuple[str, Rider]]:
    """Return the riders that stand beside the controllers in Fig. 11."""
    return [(name, make_rider(name)) for name in ("stanley", "lqr")]
