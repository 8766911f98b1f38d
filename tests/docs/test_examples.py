"""Each program in examples/ runs to its end, shortened by its own options."""

import runpy
import sys
from pathlib import Path

import pytest

from bike_training.tasks.path import REWARD_TERMS

TESTS = Path(__file__).parents[1]
EXAMPLES = TESTS.parent / "examples"
SHORT = {
    "cleanrl_ppo": "--count 2 --steps 8 --updates 2",
    "gymnasium_sb3": "--count 2 --steps 2050",
    "own_reward_term": "--steps 20",
    "recording_to_pandas": str(TESTS / "analysis/recordings/ride_of_2be20ba.mcap"),
    "ride_in_process": "--seconds 5 --rider lqr",
    "ros_lockstep": "--seconds 5",
    "rsl_rl_ppo": "--count 2 --updates 2",
    "vector_environment": "--count 2 --steps 5",
}


def test_every_program_is_run() -> None:
    assert sorted(SHORT) == sorted(path.stem for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.ros] * name.startswith("ros")) for name in SHORT]
)
def test_it_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *SHORT[name].split()])
    try:
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    finally:
        REWARD_TERMS.pop("calm", None)  # type: ignore[attr-defined]
    assert capsys.readouterr().out.strip()
