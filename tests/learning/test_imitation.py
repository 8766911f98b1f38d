"""Imitation of a teacher that is told the world, and the learner that goes on from the actor that imitates."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load_file

from bike_policy.contract.bundle import Actor
from bike_policy.planning.grip import AdaptiveLaw, GripMemory, GripPlans
from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS, LinePlan, on_grip, plan_line
from bike_policy.riders.lqr import LqrRider, LqrSettings
from bike_sim.course.course import Course
from bike_sim.course.random_courses import PathRanges
from bike_sim.sim.batch import SUPERBIKE_ENGINE
from bike_sim.vehicles.files import load_superbike
from bike_training.curricula.parts import RideRanges
from bike_training.envs.vec_env import BatchVecEnv
from bike_training.learning import imitation
from bike_training.learning.imitation import Imitation
from bike_training.learning.presets import Preset, load_preset
from bike_training.learning.process import LearningProcess, make_environment
from bike_training.learning.process import imitate as imitate_first
from bike_training.learning.run_settings import IMITATED, RunSettings
from bike_training.learning.teachers import LATERAL, gentleness, teacher_of, told_grip
from bike_training.tasks.path import PathTask
from bike_training.tasks.race import RaceState

VEHICLE = "panigale_v4r"


@pytest.fixture(scope="module")
def preset(oval: str) -> Preset:
    """Imitation and a few steps on an oval, on two roads that nobody tells of."""
    small = {
        "layers": "32",
        "environments": "4",
        "updates": "2",
        "batch_size": "64",
        "rounds": "2",
        "critic_steps": "0",
    }
    changes = {f"learner.{name}": value for name, value in small.items()}
    changes |= {"learner.learning_starts": "20", "learner.layer_norm": "false", "learner.averaging": "0"}
    worlds = {"task.disturbances": "[road_090]", "task.max_steps": "50"}
    return load_preset("race_adaptive").changed({**changes, **worlds, "curriculum.circuits": [oval]})


@pytest.fixture(scope="module", autouse=True)
def short() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imitation, "DURATION", 2.0)
        patch.setattr(imitation, "UPDATES", 60)
        yield


def settings(preset: Preset) -> RunSettings:
    return RunSettings(preset, VEHICLE, engine=SUPERBIKE_ENGINE)


def imitate(preset: Preset, out: Path, rounds: int) -> Imitation:
    own = settings(preset.changed({"learner.rounds": rounds}))
    episodes = own.preset.curriculum.make([load_superbike(VEHICLE)]).episodes(0)
    with closing(make_environment(own, own.preset.task, episodes)) as env:
        found = Imitation(env, own.preset.sac, 0)
        found.run(out)
        return found


@pytest.fixture(scope="module")
def whole(preset: Preset, short: None, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Actor]:
    """The folder of an imitation, and its actor."""
    folder = tmp_path_factory.mktemp("imitation") / "whole"
    return folder, imitate(preset, folder, 2).actor()


@pytest.mark.slow
def test_an_interrupted_imitation_goes_on_as_if_never_stopped(
    tmp_path: Path, preset: Preset, whole: tuple[Path, Actor], monkeypatch: pytest.MonkeyPatch
) -> None:
    rode = Imitation._ride

    def interrupted(self: Imitation) -> dict[str, np.ndarray]:
        if self.done == 1:
            raise KeyboardInterrupt
        return rode(self)

    with monkeypatch.context() as patched:
        patched.setattr(Imitation, "_ride", interrupted)
        with pytest.raises(KeyboardInterrupt):
            imitate(preset, tmp_path / "parts", 2)
    parts = imitate(preset, tmp_path / "parts", 2)
    for name, tensor in whole[1].tensors().items():
        np.testing.assert_array_equal(parts.actor().tensors()[name], tensor)


@pytest.mark.slow
def test_the_learner_begins_as_the_actor_that_imitates_and_stays_near(
    tmp_path: Path, preset: Preset, whole: tuple[Path, Actor]
) -> None:
    """It keeps it bit for bit while the critics learn alone, and moves on from there."""
    folder, imitated = whole
    shutil.copytree(folder, tmp_path / "run")
    held, compared = preset.changed({"learner.critic_steps": "44"}), []

    def compare(process: LearningProcess) -> None:
        if process.model.num_timesteps == 40:
            compared.append(process.model._n_updates)
            for name, tensor in imitated.tensors().items():
                np.testing.assert_array_equal(process.actor().tensors()[name], tensor)

    with closing(LearningProcess(settings(held), tmp_path / "run", 60)) as process:
        process.run(compare)
        assert compared[0] > 0
        tensors = process.actor().tensors()
        assert 0.0 < max(np.abs(tensors[name] - tensor).max() for name, tensor in imitated.tensors().items()) < 0.01


@pytest.fixture(scope="module")
def bicycle() -> Preset:
    """Imitation and a few steps on paths."""
    small = {"environments": "8", "layers": "[32, 32]", "updates": "2", "batch_size": "64", "rounds": "3"}
    small |= {"learning_starts": "20", "averaging": "0", "critic_steps": "44"}
    return load_preset("precise").changed({f"learner.{name}": value for name, value in small.items()})


@pytest.mark.slow
def test_a_bicycle_is_imitated_and_the_learner_begins_as_its_actor(tmp_path: Path, bicycle: Preset) -> None:
    """The networks of the learner see other coordinates; what they answer is the same but for rounding."""
    own = RunSettings(bicycle, "whipple")
    losses: list[float] = []
    imitate_first(own, tmp_path / "run", lambda imitation: losses.append(imitation.loss))
    assert losses[-1] < 0.5 * losses[0]
    imitated = Actor.from_tensors(load_file(tmp_path / "run" / IMITATED))
    compared = []

    def compare(process: LearningProcess) -> None:
        if process.model.num_timesteps == 40:
            assert isinstance(process.env, BatchVecEnv)
            seen = process.env.rides.observe(process.env.batch)
            compared.append(np.abs(process.actor().act_batch(seen) - imitated.act_batch(seen)).max())

    with closing(LearningProcess(own, tmp_path / "run", 48)) as process:
        process.run(compare)
    assert compared[0] < 1e-4


def test_a_misled_actor_sees_what_it_would_see_if_that_were_asked(preset: Preset, oval: str) -> None:
    own = settings(preset)
    episodes = own.preset.curriculum.make([load_superbike(VEHICLE)]).episodes(0)
    with closing(make_environment(own, own.preset.task, episodes)) as env:
        env.reset()
        layout, rides, count = env.task.layout, env.rides, env.num_envs
        assert isinstance(rides, RaceState)
        seen = rides.observe(env.batch)
        misled = imitation.Misled(layout, np.arange(count) > 0)
        np.testing.assert_allclose(misled.shown(seen), seen, atol=1e-6)
        misled.draw(np.random.default_rng(2), 1.0)
        assert misled.asked[0] == 1.0
        assert (misled.asked != 1.0).any()
        rides.interface.references.share *= misled.asked
        asked, shown = rides.observe(env.batch), misled.shown(seen)
    margins = [place for place, name in enumerate(layout.names) if name.startswith("speed_margin")]
    within = np.abs(seen[:, margins]) < 1.0  # those at their bounds are larger than they look
    np.testing.assert_allclose(shown[:, margins][within], asked[:, margins][within], atol=1e-6)
    assert within.mean() > 0.1
    beside = layout.names.index("lateral_error")
    np.testing.assert_allclose(shown[:, beside] - seen[:, beside], misled.beside / 5.0, atol=1e-6)
    others = [place for place, name in enumerate(layout.names) if place not in {*margins, beside}]
    np.testing.assert_array_equal(shown[:, others], seen[:, others])


def test_while_it_learns_an_actor_sees_the_plan_that_its_teacher_rides_by(preset: Preset) -> None:
    own = settings(preset)
    episodes = own.preset.curriculum.make([load_superbike(VEHICLE)]).episodes(0)
    with closing(make_environment(own, own.preset.task, episodes)) as env:
        env.reset()
        line = env.batch.course(0)
        assert isinstance(env.rides, RaceState)
        seen, alone = env.rides.interface.references, env.rides.interface.references.lines.samples.copy()
        plans = GripPlans(load_superbike(VEHICLE), line, CLASSICAL_SETTINGS, slower_plan(line))
        env.rides.interface.show(lambda _: plans)
        env.reset()
        assert np.any(seen.lines.samples[-len(alone) :] != alone)
        Imitation(env, own.preset.sac, 0)
        env.reset()
        taught = seen.lines.samples
    law = AdaptiveLaw(load_superbike(VEHICLE), 0.02, CLASSICAL_SETTINGS)
    reference = law.plans(line).reference.table
    np.testing.assert_array_equal(taught[-len(reference) :], reference)


def slower_plan(line: Course) -> LinePlan:
    """A plan of two thirds of the grip."""
    return plan_line(on_grip(load_superbike(VEHICLE), 0.67), line, CLASSICAL_SETTINGS)


def test_the_teacher_of_paths_is_stiff_on_a_straight(bicycle: Preset) -> None:
    own = RunSettings(bicycle, "whipple")
    ranges = RideRanges((2.0, 2.0), PathRanges(50.0, 50.0, 60.0, 60.0, 1.0, 1.0), perturb=False)
    with closing(make_environment(own, own.preset.task, ranges)) as env:
        assert isinstance(env, BatchVecEnv)
        assert isinstance(env.task, PathTask)
        env.reset()
        teacher, batch = teacher_of(env), env.batch
        rider, compared = LqrRider(LqrSettings(lateral=max(LATERAL))), 0
        for row in range(batch.count):
            teacher.begin(row, np.random.default_rng(0))
        taught = teacher.actions()[:, 0] * env.task.max_steer / batch.vehicle.max_steer
        for row in range(batch.count):
            rider.begin(batch.vehicle, batch.course(row), batch.config.control_period, env.task.preview)
            if rider.ahead(batch.look[row], 20).any():
                assert taught[row] == pytest.approx(rider.steering(batch.look[row], batch.state[row]), abs=1e-6)
                compared += 1
        assert compared > 0


@given(st.floats(0.0, 2.0), st.floats(0.0, 0.1), st.floats(1.0, 10.0), st.floats(0.0, 3.0), st.floats(0.0, 0.1))
def test_it_is_the_gentler_the_farther_from_the_line_and_the_sharper_it_bends(
    distance: float, farther: float, speed: float, bends: float, sharper: float
) -> None:
    place = gentleness(distance, speed, bends)
    assert place <= gentleness(distance + farther, speed, bends)
    assert place <= gentleness(distance, speed, bends + sharper)
    assert 0.0 <= place <= len(LATERAL) - 1


def test_it_tells_a_push_from_a_hairpin() -> None:
    """As far aside, it is the gentlest rider where pushes throw down, and no gentler than the LQR where hairpins do."""
    assert gentleness(0.15, 2.5, 0.0) == len(LATERAL) - 1
    assert LATERAL[int(gentleness(0.15, 4.0, 0.9))] == LqrSettings().lateral
    assert gentleness(0.15, 6.0, 0.0) == len(LATERAL) - 1


def test_the_teacher_rides_on_no_more_grip_than_there_is_and_than_can_be_known() -> None:
    true, inferred = np.array([0.8, 0.95, 1.2]), GripMemory(load_superbike(VEHICLE), 0.02, 3)
    assert np.all(told_grip(true, inferred)[1] < [0.81, 0.9, 0.9])
    inferred.variance[:], inferred.grip[:], inferred.expected[:] = 1e-4, (0.9, 0.9, 1.1), (0.9, 0.85, 1.1)
    np.testing.assert_allclose(told_grip(true, inferred)[1], [0.8, 0.85, 1.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"learner.learner": "sb3"}, "rounds=2 needs the learner sbx"),
        ({"learner.rounds": "0", "learner.anchor": "3"}, "anchor=3.0 needs learner.rounds"),
    ],
)
def test_settings_that_mean_nothing_are_refused(preset: Preset, changes: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        preset.changed(changes)
