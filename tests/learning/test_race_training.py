"""Learning to race: something is learned in seconds, and a run goes on as if never stopped, its curriculum too."""

import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from bike_policy.contract.bundle import Actor
from bike_sim.sim.batch import SUPERBIKE_ENGINE
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.files import load_vehicle
from bike_training.curricula.base import EndedEpisode
from bike_training.curricula.race import (
    CircuitSet,
    RaceCurriculum,
    RaceCurriculumSettings,
)
from bike_training.curricula.spdl import (
    FIRST_MEAN,
    TARGET_MEAN,
    Gaussian,
    ScheduleSettings,
    SpdlCurriculum,
    SpdlSettings,
    TargetSettings,
    log_mass_inside,
)
from bike_training.learning.presets import Preset, load_preset
from bike_training.learning.process import LearningProcess
from bike_training.learning.run_settings import RunSettings
from bike_training.learning.validation import SideBySide, ride_side_by_side
from bike_training.tasks.race import RaceContext, RaceTask

VEHICLE = "panigale_v4r"
SMALL = {
    "learner": "sb3",
    "learner.layers": "16,16",
    "learner.environments": "4",
    "learner.updates": "2",
    "learner.batch_size": "64",
}
RACE, RACE_DIRECT = load_preset("race"), load_preset("race_direct")


class Circuits:
    """A set of circuits without their lines: speeds of starts are a formula."""

    def __init__(self, names: tuple[str, ...] = ("barcelona",)) -> None:
        self.names = names

    def length(self, name: str) -> float:
        return 4657.0

    def start(self, name: str, lam: float, progress: float, share: float, row: int = 0) -> float:
        return share * (50.0 + 1e-3 * progress + 10.0 * lam)


@pytest.fixture(scope="module")
def circuits() -> Circuits:
    return Circuits()


def settings(preset: Preset, seed: int = 0, vehicle: str = VEHICLE) -> RunSettings:
    return RunSettings(preset, vehicle, seed, engine=SUPERBIKE_ENGINE)


def final_actor(preset: Preset, out: Path, steps: int, vehicle: str = VEHICLE, resume: bool = False) -> Actor:
    process = LearningProcess(settings(preset, vehicle=vehicle), out, steps, resume=resume)
    process.run()
    return process.actor()


@pytest.mark.slow
def test_throttle_is_learned_in_seconds(tmp_path: Path) -> None:
    """Rewarded for the way alone, the actor opens the throttle: it is much faster on the straight than at first."""
    changes = {"learning_rate": 3e-3, "final_learning_rate": 3e-3, "learning_starts": 200, "averaging": 0.0}
    changes = {f"learner.{name}": value for name, value in {"gamma": 0.9, **changes}.items()}
    task = {"task.weights": "{progress: 3}", "task.max_steps": "20", "task.repeat": "5"}
    preset = RACE_DIRECT.changed({**SMALL, **task, **changes})
    task = replace(preset.task, validation_duration=2.0)
    request = ResetRequest(course="barcelona", speed_range=(30.0, 30.0), progress=300.0)
    process = LearningProcess(settings(preset), tmp_path / "run", 1600)
    before = ride_side_by_side(process.actor(), task, process.settings.simulator(), [request])[0][-1]
    process.run()
    after = ride_side_by_side(process.actor(), task, process.settings.simulator(), [request])[0][-1]
    assert after[0] < before[0] - 0.08


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "changes", "vehicle"),
    [
        (RACE_DIRECT, {"curriculum": "spdl", "curriculum.iteration": "40"}, VEHICLE),
        (RACE, {"task.observation": "conditioned"}, f"{VEHICLE},r1"),
    ],
    ids=["spdl", "guided machines"],
)
def test_a_resumed_run_is_the_uninterrupted_one(
    tmp_path: Path, preset: Preset, changes: dict[str, str], vehicle: str, oval: str
) -> None:
    preset = preset.changed({**SMALL, "task.max_steps": "6", "curriculum.circuits": [oval], **changes})
    constant = {"learner.learning_starts": 30, "learner.final_learning_rate": preset.sac.learning_rate}
    preset = preset.changed(constant)  # the same for any length
    whole = final_actor(preset, tmp_path / "whole", 120, vehicle)
    final_actor(preset, tmp_path / "parts", 60, vehicle)
    resumed = final_actor(preset, tmp_path / "parts", 120, vehicle, resume=True)
    for name, tensor in whole.tensors().items():
        np.testing.assert_array_equal(resumed.tensors()[name], tensor)
    stored = load_file(tmp_path / "whole" / "checkpoint" / "tensors.safetensors")
    again = load_file(tmp_path / "parts" / "checkpoint" / "tensors.safetensors")
    assert stored.keys() == again.keys()
    for name, tensor in stored.items():
        np.testing.assert_array_equal(again[name], tensor, err_msg=name)


def test_vehicles_that_are_kept_ride_the_next_validation_as_new_ones_do(oval: str) -> None:
    circuits = CircuitSet(load_vehicle(VEHICLE), [oval])
    task = replace(RACE.task, validation_duration=3.0)
    config = settings(RACE).simulator()
    rng = np.random.default_rng(0)
    rides = [RaceCurriculum(circuits).validation_requests(task.preview, rng) for _ in range(2)]
    actors = [
        Actor([rng.normal(size=(2, task.layout.size)).astype(np.float32)], [np.zeros(2, dtype=np.float32)])
        for _ in rides
    ]
    with closing(SideBySide(task, 4, config)) as kept:
        kept.errors(actors[0], rides[0])
        again = kept.errors(actors[1], rides[1])
    with closing(SideBySide(task, 4, config)) as fresh:
        assert again == fresh.errors(actors[1], rides[1])
    assert len(set(again)) > 1


def ended(request: ResetRequest, total: float = 1.0, failed: bool = False, progress: float = 0.0) -> EndedEpisode:
    return EndedEpisode(request, total, 100, failed, progress)


def test_starts_lie_all_around_and_lead_up_to_failures(circuits: Circuits) -> None:
    rng = np.random.default_rng(0)
    preview = RaceTask().preview
    curriculum = RaceCurriculum(circuits, RaceCurriculumSettings(failure_share=0.5))
    even = [curriculum.episodes(0).draw(rng, preview) for _ in range(200)]
    length = circuits.length("barcelona")
    counts, _ = np.histogram([request.progress for request in even], bins=8, range=(0.0, length))
    assert counts.min() >= 10
    for request in even[:20]:
        assert request.speed_range[0] < circuits.start("barcelona", 1.0, request.progress, 0.96) + 1e-9
    for _ in range(50):
        curriculum.ended(ended(even[0], failed=True, progress=2000.0))
    led = [curriculum.episodes(0).draw(rng, preview).progress for _ in range(200)]
    near = sum(1500.0 < progress < 2000.0 for progress in led)
    assert near > 3 * sum(1500.0 < request.progress < 2000.0 for request in even)


def test_validations_ride_some_of_many_circuits(circuits: Circuits) -> None:
    preview = RaceTask().preview
    many = Circuits(("barcelona", "cremona", "phillip_island"))
    curriculum = RaceCurriculum(many, RaceCurriculumSettings(sampled=2))
    rng = np.random.default_rng(0)
    drawn = [curriculum.validation_requests(preview, rng) for _ in range(20)]
    assert {len(requests) for requests in drawn} == {8}
    assert {len({request.course for request in requests}) for requests in drawn} == {2}
    assert {request.course for requests in drawn for request in requests} == set(many.names)
    compared = curriculum.selection_requests(preview)
    assert compared == curriculum.selection_requests(preview)
    assert [request.course for request in compared] == ["barcelona"] * 16 + ["cremona"] * 16
    assert len(RaceCurriculum(circuits).selection_requests(preview)) == 32


PACED = SpdlSettings(spread=0.1, failure_share=0.5, threshold=1.0, kl=1.0, iteration=10)


@pytest.fixture(scope="module")
def paced(circuits: Circuits) -> tuple[SpdlCurriculum, int]:
    """Return the curriculum of an agent that is always good, close to the target, and its step."""
    curriculum, rng, preview, step = SpdlCurriculum(circuits, PACED), np.random.default_rng(0), RaceTask().preview, 0
    while not curriculum.contexts.steps or curriculum.contexts.steps[-1][-2] > 1e-3:
        step += 10
        assert step < 3000
        episodes = curriculum.episodes(step)
        for _ in range(30):
            curriculum.ended(ended(episodes.draw(rng, preview), total=2.0))
    return curriculum, step


def test_spdl_leads_a_good_agent_to_the_ideal_line_and_survives_a_checkpoint(
    circuits: Circuits, paced: tuple[SpdlCurriculum, int]
) -> None:
    curriculum, step = paced
    begin, other = SpdlCurriculum(circuits, PACED), SpdlCurriculum(circuits, PACED)
    rng, preview = np.random.default_rng(0), RaceTask().preview
    first, last = (
        [RaceContext.of(each.episodes(at).draw(rng, preview)) for _ in range(100)]
        for each, at in ((begin, 0), (curriculum, step))
    )
    for name, sign in (("d_median", 1.0), ("d_ideal", -1.0), ("v_max", 1.0)):
        begun, now = (np.mean([getattr(context, name) for context in drawn]) for drawn in (first, last))
        assert sign * now > sign * begun
    apart = [entry[-2] for entry in curriculum.contexts.steps]
    assert apart == sorted(apart, reverse=True)
    other.restore(curriculum.state_dict())
    draws = [each.episodes(step).draw(np.random.default_rng(5), preview) for each in (curriculum, other)]
    assert draws[0] == draws[1]
    assert other.figures() == curriculum.figures()


@pytest.mark.parametrize(
    ("kind", "settings"), [(RaceCurriculum, RaceCurriculumSettings), (SpdlCurriculum, TargetSettings)]
)
def test_episodes_begin_at_the_start_line_where_that_is_set(circuits: Circuits, kind: type, settings: type) -> None:
    rng = np.random.default_rng(0)
    for start_line in (True, False):
        episodes = kind(circuits, settings(start_line=start_line)).episodes(0)
        starts = {episodes.draw(rng, RaceTask().preview).progress for _ in range(20)}
        assert (starts == {0.0}) == start_line


def test_both_arms_of_the_comparison_draw_the_same_episodes_at_the_target(
    circuits: Circuits, paced: tuple[SpdlCurriculum, int]
) -> None:
    """Requests are compared and not settings: starts, lines, speeds, shares; only the number of the update differs."""
    reached, alone = (
        SpdlCurriculum(circuits, PACED),
        SpdlCurriculum(circuits, TargetSettings(spread=0.1, failure_share=0.5)),
    )
    reached.restore(paced[0].state_dict())
    reached.contexts.distribution = reached.contexts.target  # the last bits of the way
    reached.contexts._history.append(reached.contexts.distribution)
    reached.failures = alone.failures
    for seed in range(200):
        drawn = [
            each.episodes(paced[1]).draw(np.random.default_rng(seed), RaceTask().preview) for each in (reached, alone)
        ]
        contexts = [RaceContext.of(request) for request in drawn]
        assert contexts[0].share == contexts[1].share != 1.0
        assert replace(drawn[0], context=()) == replace(drawn[1], context=())
        assert contexts[0]._replace(number=0.0) == contexts[1]._replace(number=0.0)


def test_a_fixed_schedule_ends_at_the_target_whatever_the_returns(circuits: Circuits) -> None:
    curriculum = SpdlCurriculum(circuits, ScheduleSettings(iteration=10, schedule=100))
    for step in range(10, 130, 10):
        curriculum.episodes(step)
    apart = [entry[-2] for entry in curriculum.contexts.steps]
    assert apart == sorted(apart, reverse=True)
    assert apart[-1] == pytest.approx(0.0, abs=1e-9)
    assert curriculum.contexts.steps[4][3] == pytest.approx((0.5 * np.add(FIRST_MEAN, TARGET_MEAN)).tolist())
    jumping = SpdlCurriculum(circuits, ScheduleSettings(iteration=10, schedule=100, stages=2))
    for step in range(10, 130, 10):
        jumping.episodes(step)
    jumps = [entry[-2] for entry in jumping.contexts.steps]
    assert jumps == pytest.approx([jumps[0]] * 4 + [apart[4]] * 5 + [0.0] * 3, abs=1e-9)
    assert jumps[0] > apart[0]


def test_an_update_looks_at_the_episodes_since_the_one_before(circuits: Circuits) -> None:
    """Returns that were low long ago do not hold an agent back that has become good."""
    curriculum = SpdlCurriculum(circuits, SpdlSettings(threshold=1.0, kl=1.0, iteration=10))
    rng, preview = np.random.default_rng(0), RaceTask().preview
    for step, total in ((10, 0.0), (20, 2.0)):
        episodes = curriculum.episodes(step - 10)
        for _ in range(90):
            curriculum.ended(ended(episodes.draw(rng, preview), total=total))
        curriculum.episodes(step)
    assert [entry[-1] for entry in curriculum.contexts.steps] == pytest.approx([0.0, 2.0])


def test_densities_are_those_of_contexts_drawn_within_their_limits() -> None:
    """The mass of a Gaussian within [0, 1] per number, independent ones and half of one cut off."""
    whole = Gaussian.with_std((0.5, 0.5, 0.5), (0.01, 0.01, 0.01))
    corner = Gaussian.with_std((1.0, 0.0, 1.0), (0.04, 0.04, 0.04))
    assert log_mass_inside(whole) == 0.0
    assert math.exp(log_mass_inside(corner)) == pytest.approx(1 / 8, abs=0.02)


def test_presets_name_their_circuits_and_refuse_bicycles(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"'race' is for superbikes on circuits, and '.*' is none"):
        LearningProcess(RunSettings(load_preset("race_paper"), "whipple"), tmp_path / "run", 10)
    with pytest.raises(FileNotFoundError, match="nowhere"):
        LearningProcess(settings(RACE_DIRECT.changed({"curriculum.circuits": "nowhere"})), tmp_path / "run", 10)
