"""Races of learners, their recordings and the command: environments of both kinds, one file, the same race again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test

from bike_sim.sim.race import Entry, RaceSettings
from bike_training.cli import main
from bike_training.envs.race_env import RACE_TASK, RaceEnv, RaceParallelEnv
from bike_training.tasks.race import RaceTask
from tests.circuits import OVAL

MACHINES = tuple(Entry(f"bike_{k}", "panigale_v4r", "classical") for k in range(3))


@pytest.fixture(scope="module")
def oval(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("race") / "oval.yaml"
    path.write_text(OVAL, encoding="utf-8")
    return str(path)


@pytest.fixture(scope="module")
def env(oval: str) -> RaceParallelEnv:
    return RaceParallelEnv(RaceSettings(oval, 1, MACHINES, line=0.0), max_steps=40)


def test_pettingzoo_checks_pass(env: RaceParallelEnv) -> None:
    """Its own tests of the interface and of seeds."""
    parallel_api_test(env, num_cycles=20)
    parallel_seed_test(lambda: RaceParallelEnv(env.rides.race.settings, max_steps=8), num_cycles=3)


def test_agents_see_each_other_from_their_places(env: RaceParallelEnv) -> None:
    """The first sees one behind, the last two ahead, and a grid that is asked for is that of the race."""
    seen, _ = env.reset(seed=0, options={"grid": [2, 0, 1]})
    layout = RACE_TASK.layout
    place = layout.places["opponents"]
    names = layout.names[place]
    shown = {
        name: {names[i].removesuffix("_present") for i in range(0, 25, 5) if seen[name][place][i] > 0.0}
        for name in seen
    }
    assert shown == {"bike_2": {"behind"}, "bike_0": {"ahead_1", "behind"}, "bike_1": {"ahead_1", "ahead_2"}}


def test_gymnasium_check_passes(oval: str) -> None:
    """One learner among fixed riders, from the back of the grid."""
    env = RaceEnv(RaceSettings(oval, 1, MACHINES[:2], line=0.0), "bike_0", last=True)
    check_env(env, skip_render_check=True)
    env.reset(seed=1)
    assert env.rides.race.grid[0] == 2
    _, reward, _, _, info = env.step(np.zeros(2, dtype=np.float32))
    assert np.isfinite(reward)
    assert info["position"] == 2
    env.close()


def test_tasks_that_cannot_see_others_are_refused(oval: str) -> None:
    """The error names the observation."""
    with pytest.raises(ValueError, match="'compact' cannot see others"):
        RaceParallelEnv(RaceSettings(oval, 1, MACHINES), RaceTask())


def test_race_is_recorded_in_one_file_and_raced_again(
    oval: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command writes one recording and a page; the same race comes out of it, each machine is a ride."""
    pytest.importorskip("rclpy")
    machines = ["one=panigale_v4r", "panigale_v4r:solo:classical"]
    words = ["race", *machines, "--course", oval, "--line", "0", "--laps", "1", "--out", str(tmp_path / "race")]
    assert main([*words, "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert [line["end"] for line in figures["classification"]] == ["finished"] * 2
    assert sorted(line["name"] for line in figures["classification"]) == ["bike_2", "one"]
    page = Path(figures["page"]).read_text(encoding="utf-8")
    assert all(page.count(f">{name}</option>") == 2 for name in ("one", "bike_2"))  # behind whom, gaps to whom
    recording = figures["recording"]
    assert main(["race", "--replay", recording]) == 0
    assert "bit for bit" in capsys.readouterr().out
    assert main(["analyze", recording, "--namespace", "/one", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["figures"]["rides"]) == 1


@pytest.mark.parametrize(
    ("machines", "words"),
    [
        (["a=r1", "a=r1"], "two machines of a race are called 'a'"),
        (["r1", "zx10rr:racer"], "cannot see others"),
        (["a b=r1", "r1"], "letters, digits and underscores"),
    ],
)
def test_races_that_cannot_be_are_refused(
    oval: str, machines: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One clear line each, and no recording."""
    out = tmp_path / "out"
    assert main(["race", *machines, "--course", oval, "--line", "0", "--out", str(out)]) == 2
    assert words in capsys.readouterr().err
    assert not list(out.glob("*.mcap"))
