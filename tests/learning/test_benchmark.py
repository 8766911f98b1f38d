"""The frozen tasks: they do not change, keep the contracts of environments, and their results can be verified."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_for_learners

from bike_policy.contract.bundle import load_bundle
from bike_policy.contract.observation import Rows
from bike_sim.schema import LOOK, STATE
from bike_training.benchmark import evaluation, tasks
from bike_training.benchmark.evaluation import errors_of, record_actions, record_rider, write_results
from bike_training.benchmark.tasks import BENCHMARKS, benchmark_of
from bike_training.cli import main
from bike_training.gymnasium_ids import BENCHMARK_STEPS
from bike_training.tasks.path import PathTask
from bike_training.tasks.race import RaceTask

PUSHES = "two_wheeler/Pushes-v0"
LATE = "two_wheeler/LateCommands-v0"
LAP = "two_wheeler/Lap-v0"
BICYCLES = [name for name in BENCHMARKS if not isinstance(BENCHMARKS[name].task, RaceTask)]
CHECKED = [*BICYCLES, LAP]
"""Those whose circuits need no plan of a line that takes long; the others differ from Lap in starts and worlds."""
FROZEN = json.loads((Path(__file__).parent / "benchmark_v0.json").read_text())
"""Digest of starts and rollout of each task, as they were when it was frozen."""


def digest(values: Any) -> str:
    """Digest of numbers, rounded so that no last bit decides."""
    rounded = np.round(np.asarray(values, dtype=np.float64), 3) + 0.0
    return hashlib.sha256(rounded.tobytes()).hexdigest()[:16]


def rollout_of(name: str) -> Iterator[np.ndarray]:
    """A fixed rollout: observations and rewards of three rows under fixed actions."""
    env = gymnasium.make_vec(name, num_envs=3)
    observation, _ = env.reset(seed=7)
    rng = np.random.default_rng(8)
    yield observation
    for _ in range(25):
        actions = rng.uniform(-0.2, 0.2, env.action_space.shape).astype(np.float32)
        observation, reward, *_ = env.step(actions)
        yield np.column_stack([observation, reward])
    env.close()


def test_every_row_has_its_environment() -> None:
    assert list(BENCHMARKS) == list(BENCHMARK_STEPS) == list(FROZEN)
    for name, steps in BENCHMARK_STEPS.items():
        assert gymnasium.spec(name).max_episode_steps == BENCHMARKS[name].task.max_steps == steps


@pytest.mark.parametrize("name", CHECKED)
def test_a_version_never_changes(name: str) -> None:
    requests = benchmark_of(name).judged_requests()
    starts = [[r.seed % 2**31, *r.speed_range, r.progress, r.start_offset, *(r.initial_state or ())] for r in requests]
    found = {"starts": digest(starts), "rollout": digest(np.concatenate(list(rollout_of(name)), axis=None))}
    assert found == FROZEN[name]


@pytest.mark.parametrize("name", CHECKED)
def test_environments_keep_both_contracts_without_a_warning(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(name, render_mode="rgb_array")
        check_env(env.unwrapped)
        check_for_learners(env.unwrapped)
        assert env.observation_space.is_bounded()
        assert env.action_space.is_bounded()
        first, _ = env.reset(seed=3)
        again, _ = env.reset(seed=3)
        np.testing.assert_array_equal(first, again)
        assert env.render().shape == (540, 960, 3)
        env.close()


@pytest.mark.parametrize("name", [PUSHES, LATE])
def test_a_single_environment_rides_as_a_row_of_a_batch(name: str) -> None:
    env, batch = gymnasium.make(name), gymnasium.make_vec(name, num_envs=2)
    seen, _ = batch.reset(seed=5)
    request = batch.unwrapped._env._requests[1]
    np.testing.assert_array_equal(env.reset(options={"request": request})[0], seen[1])
    rng = np.random.default_rng(6)
    for _ in range(30):
        actions = rng.uniform(-0.1, 0.1, (2, 1)).astype(np.float32)
        rows = batch.step(actions)
        one = env.step(actions[1])
        np.testing.assert_array_equal(one[0], rows[0][1])
        assert one[1] == pytest.approx(rows[1][1], abs=1e-6)
    assert not one[2]


def test_an_episode_does_not_go_on_into_the_next() -> None:
    env = gymnasium.make("two_wheeler/Junction-v0").unwrapped
    env.task = replace(env.task, max_steps=2)
    env.reset(seed=1)
    for _ in range(2):
        result = env.step(np.zeros(1, np.float32))
    assert result[3]
    before = env.snapshot.episode
    env.reset()
    assert env.snapshot.episode == before + 1


def test_commands_act_late_where_the_task_says_so() -> None:
    late, prompt = (gymnasium.make(name).unwrapped for name in (LATE, "two_wheeler/Path-v0"))
    request = benchmark_of(LATE).judged_requests()[0]
    steers = []
    for env in (late, prompt):
        env.reset(options={"request": request})
        steers.append([env.step(np.full(1, 0.3, np.float32)) and env.snapshot.steering for _ in range(4)])
    assert steers[0][:2] == [0.0, 0.0]
    assert steers[0][2:] == steers[1][2:] != [0.0, 0.0]


def test_compiled_observation_and_reward_are_those_of_the_task() -> None:
    benchmark, rng = benchmark_of(PUSHES), np.random.default_rng(4)
    state, look = rng.normal(0.0, 1.0, (50, len(STATE))), rng.normal(0.0, 2.0, (50, len(LOOK)))
    preview = rng.normal(0.0, 1.0, (50, 2, benchmark.task.layout.preview_count))
    rows = Rows.of_path(state, look, preview)
    compiled = benchmark.task.make_state(50, tasks.load_vehicle(tasks.BICYCLE))
    plain = PathTask(task="fine", weights=benchmark.task.weights).make_state(50, tasks.load_vehicle(tasks.BICYCLE))
    high = benchmark.task.observation_high
    np.testing.assert_array_equal(compiled.observe(rows), np.clip(plain.observe(rows), -high, high))
    found, expected = compiled.evaluate(rows), plain.evaluate(rows)
    np.testing.assert_array_equal(found.failed, expected.failed)
    assert 5 < found.failed.sum() < 45
    for term in expected.terms:
        np.testing.assert_allclose(found.terms[term], expected.terms[term], atol=1e-15)
    state[3] = np.nan
    assert np.isfinite(compiled.observe(rows)).all()
    assert compiled.evaluate(rows).failed[3]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of the classical rider, whose score is 0."""
    folder = tmp_path_factory.mktemp("pushes")
    found = write_results(folder, PUSHES, "lqr", record_rider(benchmark_of(PUSHES), "lqr"))
    assert found["score"] == pytest.approx(0.0, abs=1e-3)
    assert found["failed"] == 0
    return folder


def test_true_results_are_found_true_and_false_ones_named(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = results / "results.json"
    assert main(["evaluate", "--verify", str(path)]) == 0
    assert "true" in capsys.readouterr().out
    claims = json.loads(path.read_text())
    claims["episodes"][3]["error"] *= 0.9
    claims["score"] = 0.5
    false = results / "false.json"
    false.write_text(json.dumps(claims))
    assert main(["evaluate", "--verify", str(false)]) == 1
    told = capsys.readouterr().out
    assert "not true" in told
    assert "episode 4: an error of" in told
    assert "score 0.5 is claimed" in told


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": "bike.benchmark/2"}, "results of 'bike.benchmark/2', this software verifies bike.benchmark/1"),
        ({"task": "two_wheeler/Pushes-v7"}, "unknown task or version 'two_wheeler/Pushes-v7'; did you mean"),
        ({"task": "two_wheeler/Balance-v0"}, "recorded commands have the shape"),
        ({"episodes": "none"}, "false.json: "),
        ({"commands": "../../etc/passwd"}, "passwd"),
    ],
)
def test_what_cannot_be_verified_is_one_clear_line(
    results: Path, changes: dict[str, Any], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (results / "false.json").write_text(json.dumps(json.loads((results / "results.json").read_text()) | changes))
    code = main(["evaluate", "--verify", str(results / "false.json")])
    told = capsys.readouterr()
    assert (code, message in told.err) == (2, True) or (code == 1 and "episodes are claimed" in told.out)


def test_other_recordings_give_other_scores(results: Path) -> None:
    with np.load(results / evaluation.COMMANDS_FILE) as stored:
        commands = stored["commands"]
    steered = np.where(np.arange(len(commands))[:, None, None] > 20, 0.9 * commands, commands)
    whole, changed = errors_of(benchmark_of(PUSHES), commands), errors_of(benchmark_of(PUSHES), steered)
    assert [e["error"] for e in changed] != [e["error"] for e in whole]
    with pytest.raises(ValueError, match="no number in"):
        errors_of(benchmark_of(PUSHES), np.full_like(commands, np.nan))


def test_a_policy_of_the_tasks_own_observations_is_scored_as_its_rider() -> None:
    benchmark, bundle = replace(benchmark_of(PUSHES), count=8), load_bundle("whipple_exact")
    errors = [e["error"] for e in errors_of(benchmark, record_actions(benchmark, bundle.actor.act_batch))]
    ridden = [e["error"] for e in errors_of(benchmark, record_rider(benchmark, "whipple_exact"))]
    np.testing.assert_allclose(errors, ridden, atol=0.01)  # its card holds the set point within limits by speed
    assert np.isclose(errors, ridden, atol=1e-5).any()  # where these are not reached


def test_an_unknown_version_and_a_rider_of_another_vehicle_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "lqr", "--task", "two_wheeler/Path-v3"]) == 2
    assert "did you mean two_wheeler/Path-v0" in capsys.readouterr().err
    assert main(["evaluate", "lqr", "--task", LAP]) == 2
    assert "rider 'lqr' does not ride 'panigale_v4r'" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in BENCHMARKS if name not in CHECKED])
def test_a_version_never_changes_where_it_takes_minutes(name: str) -> None:
    test_a_version_never_changes(name)
    test_environments_keep_both_contracts_without_a_warning(name)
