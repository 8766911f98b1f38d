"""Learning among rivals: how races begin, who counts for what, and that the ordinary command learns it."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bike_sim.sim.race import grid_offset
from bike_sim.sim.request import COURSE_POINTS
from bike_sim.vehicles.files import load_vehicle
from bike_training.curricula.base import EndedEpisode
from bike_training.curricula.race import CircuitSet
from bike_training.curricula.rivals import RivalsCurriculum, RivalsSettings, SpdlRivalsSettings
from bike_training.envs.race_vec_env import RaceVecEnv
from bike_training.learning import imitation
from bike_training.learning.presets import load_preset
from bike_training.learning.process import LearningProcess, imitate, make_environment
from bike_training.learning.run_settings import IMITATED, RunSettings, settings_of
from bike_training.learning.teachers import LANE, teacher_of
from bike_training.tasks.race import RaceContext, places

PRESET = load_preset("race_wheel_to_wheel")
SMALL = {
    "learner.anchor": "0", "learner.critic_steps": "0", "learner.rounds": "0",
    "learner.learner": "sb3", "learner.layers": "16,16", "learner.environments": "4", "learner.updates": "1",
    "learner.batch_size": "32", "learner.learning_starts": "8", "curriculum.rivals": "1", "curriculum.learners": "2",
}  # fmt: skip


@pytest.fixture(scope="module")
def settings(oval: str) -> RunSettings:
    return settings_of(
        {
            "preset": "race_wheel_to_wheel",
            "vehicle": "panigale_v4r",
            "set": {**SMALL, "curriculum.circuits": oval, "curriculum.riders": "classical,overtaker"},
        },
        0,
    )


@pytest.fixture
def env(settings: RunSettings) -> RaceVecEnv:
    return race_of(settings)


def race_of(settings: RunSettings) -> RaceVecEnv:
    """Return the races of a run."""
    curriculum = settings.preset.curriculum.make([load_vehicle("panigale_v4r")])
    made = make_environment(settings, settings.preset.task, curriculum.episodes(0))
    assert isinstance(made, RaceVecEnv)
    return made


def test_places_are_counted_evenly_while_another_is_passed() -> None:
    """Far behind counts nothing, beside half, far ahead one; missing ones nothing."""
    far = places(np.array([[-200.0, np.nan], [0.0, np.nan], [200.0, 200.0]]))
    np.testing.assert_allclose(far, [0.0, 0.5, 2.0], atol=1e-6)
    ahead = places(np.linspace(-60.0, 60.0, 50)[:, None])
    assert (np.diff(ahead) > 0.0).all()


def test_rivals_grow_stronger_and_machines_begin_close_behind_each_other(oval: str) -> None:
    """In the last stage all ride their speed; on the way each begins within some tens of metres of the next."""
    curriculum = RivalsSettings(circuits=(oval,), stage=100, grid=0.0).make([load_vehicle("panigale_v4r")])
    rng = np.random.default_rng(0)
    lowest = []
    for step in (0, 100, 10_000):
        drawn = [curriculum.episodes(step).draw_race(rng, COURSE_POINTS, 0) for _ in range(20)]
        shares = np.array([[RaceContext(*request.context).share for request in race] for race in drawn])
        assert (shares[:, : curriculum.settings.learners] == 1.0).all()
        lowest.append(shares.min())
        along = np.sort([[request.progress for request in race] for race in drawn], axis=1)
        assert (np.diff(along, axis=1) < 60.0).all()
    assert lowest[0] < lowest[1] < lowest[2] == 1.0
    assert not curriculum.may_validate(10**9)


@pytest.mark.parametrize(("total", "reached"), [(2.0, True), (0.0, False)])
def test_spdl_leads_those_who_gain_to_full_strength_and_nobody_else(oval: str, total: float, reached: bool) -> None:
    """All rivals of a race ride the same part, learners theirs; a checkpoint goes on with the same races."""
    settings = SpdlRivalsSettings(circuits=(oval,), threshold=1.0, kl=1.0, iteration=10, strengths=(0.8,))
    curriculum, other = (settings.make([load_vehicle("panigale_v4r")]) for _ in range(2))
    rng, first, last = np.random.default_rng(0), [], []
    for step in range(0, 400, 10):
        last = []
        for _ in range(20):
            race = curriculum.episodes(step).draw_race(rng, COURSE_POINTS, 0)
            shares = [RaceContext(*request.context).share for request in race]
            assert shares[: settings.learners] == [1.0] * settings.learners
            assert len({*shares[settings.learners :]}) == 1
            last.append(shares[-1])
            curriculum.ended(EndedEpisode(race[0], total, 10, False, 0.0))
        first = first or last
    assert np.mean(first) < 0.9
    assert (np.mean(last) > 0.98) == reached
    other.restore(curriculum.state_dict())
    races = [each.draw_race(np.random.default_rng(1), COURSE_POINTS, 0) for each in (curriculum, other)]
    assert races[0] == races[1]
    assert other.figures() == curriculum.figures()


def test_a_start_from_the_grid_is_that_of_a_race(oval: str) -> None:
    """Places are 9 m apart, left and right in turn, each learner behind a rival."""
    settings = RivalsSettings(circuits=(oval,), grid=1.0, front=0.0, rivals=3, learners=3)
    circuits = CircuitSet(load_vehicle("panigale_v4r"), (oval,))
    race = RivalsCurriculum(circuits, settings).draw_race(np.random.default_rng(0), COURSE_POINTS, 0)
    order = sorted(range(6), key=lambda row: -race[row].progress)
    assert [row < 3 for row in order] == [False, True] * 3
    track = circuits.line(oval, 1.0).track
    for number, row in enumerate(order, start=1):
        assert race[row].progress == pytest.approx(track.length - 9.0 * number)
        assert race[row].start_offset == grid_offset(track, race[row].progress, number, 1.0)


def test_races_side_by_side_do_not_meet_and_end_together(env: RaceVecEnv) -> None:
    """Machines see those of their own race alone, and all learners of a race begin anew at once."""
    with closing(env):
        env.seed(1)
        env.reset()
        batch = env.batch
        for race in range(2):
            rows = slice(3 * race, 3 * race + 3)
            near = batch.opponents[rows, :, 0].sum(axis=1)
            assert (near <= 2).all()
            assert near.max() >= 1
        rewards = np.zeros(4)
        for _ in range(5):
            _, reward, ended, _ = env.step(np.zeros((4, 2), dtype=np.float32))
            rewards += reward
            assert (ended.reshape(2, 2).all(axis=1) == ended.reshape(2, 2).any(axis=1)).all()
        assert np.isfinite(rewards).all()
        env.steps[:2] = env.task.max_steps
        _, _, ended, infos = env.step(np.zeros((4, 2), dtype=np.float32))
        assert ended[:2].all()
        assert not ended[2:].any()
        assert infos[0]["TimeLimit.truncated"]
        assert env.steps.tolist()[:2] == [0, 0]


def test_the_teacher_holds_the_lane_of_the_grid_up_to_the_corner(settings: RunSettings) -> None:
    """Ridden from the grid at the most pace, its targets stay where a machine begins until shortly before a turn-in."""
    grid = replace(settings, preset=settings.preset.changed({"curriculum.grid": "1.0"}))
    with closing(race_of(grid)) as env:
        env.seed(1)
        env.reset()
        teacher, interfaces = teacher_of(env), [part.state.interface for part, _ in env.rides.each(env.batch)]
        begun = np.concatenate([interface.offsets for interface in interfaces])
        apart = np.abs(begun) > LANE
        assert apart.any()
        held, left = np.zeros(len(begun)), np.zeros(len(begun), dtype=np.bool_)
        for step in range(700):
            actions = teacher.actions()
            left |= actions[:, 0] == 0.0
            assert (actions[apart & ~left, 1] == 1.0).all()
            if step % env.task.repeat == 0:
                env.rides.act(env.batch, actions)
            env.batch.step(env.commands())
            env.rides.advance(env.batch)
            asked = np.concatenate([interface.offsets for interface in interfaces])
            held = np.where(left, held, np.abs(asked - begun))
        assert (held[apart] < 2.0).all()
        assert left.all()


@pytest.mark.slow
def test_races_are_imitated(settings: RunSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounds of rides among rivals, and an actor that answers more as the teacher does."""
    monkeypatch.setattr(imitation, "DURATION", 5.0)
    monkeypatch.setattr(imitation, "UPDATES", 60)
    small = {"learner.learner": "sbx", "learner.rounds": "3", "task.max_steps": "5"}
    own, losses = replace(settings, preset=settings.preset.changed(small)), []
    imitate(own, tmp_path, lambda rounds: losses.append(rounds.loss))
    assert losses[-1] < 0.1 * losses[0]
    assert (tmp_path / IMITATED).is_file()


def test_the_ordinary_run_learns(settings: RunSettings, tmp_path: Path) -> None:
    """A run of some steps moves the actor."""
    process = LearningProcess(settings, tmp_path / "run", 24)
    before = process.actor()
    process.run()
    after = process.actor()
    assert any((a != b).any() for a, b in zip(before.weights, after.weights, strict=True))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"task.observation": "guided"}, "cannot see others"),
        ({"curriculum.rivals": "11", "curriculum.learners": "2"}, "2 to 12"),
        ({"curriculum.strengths": "[0.1]"}, "strengths"),
        ({"curriculum.riders": "classical,"}, "riders"),
        ({"task.offset_rate": "-1"}, "offset_rate"),
    ],
)
def test_bad_settings_are_refused(changes: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PRESET.changed(changes)


def test_learners_that_do_not_fill_their_races_are_refused(settings: RunSettings) -> None:
    preset = settings.preset.changed({"learner.environments": "5"})
    curriculum = preset.curriculum.make([load_vehicle("panigale_v4r")])
    run = RunSettings(preset, "panigale_v4r", engine=settings.engine)
    with pytest.raises(ValueError, match="must be a multiple of"):
        make_environment(run, preset.task, curriculum.episodes(0))
