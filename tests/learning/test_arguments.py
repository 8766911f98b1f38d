"""What a command refuses before it starts anything: one line that names the option and the value, and exit code 2."""

import pytest

from bike_training.cli import main

pytest.importorskip("rclpy")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ride", "--speed", "0"], "--speed must be positive and finite, got 0 m/s"),
        (["ride", "--speed", "nan"], "--speed must be positive and finite, got nan m/s"),
        (["ride", "--domain", "-1"], "--domain must be 0 to 232, got -1"),
        (["ride", "--domain", "9999"], "--domain must be 0 to 232, got 9999"),
        (["ride", "--time-step", "0.003"], "not a whole number of time steps"),
        (["lap", "--nodes", "--laps", "0"], "--laps must be at least 1, got 0"),
        (["lap", "--laps", "-1"], "--laps must be at least 1, got -1"),
        (["lap", "--nodes", "--engine", "compiled"], "--nodes rides in pybullet; leave --engine compiled out"),
        (["evaluate", "--speeds", "4", "0"], "--speeds must be positive and finite, got 0 m/s"),
        (["evaluate", "--random-rides", "-1"], "--random-rides must be at least 0, got -1"),
        (["evaluate", "--seed", "-1"], "--seed must be at least 0, got -1"),
        (["evaluate", "--client", "nodes", "--course", "nowhere"], "'nowhere'"),
        (["validate", "--time-step", "0"], "--time-step must be positive and at most 0.05 s, got 0 s"),
        (["validate", "--time-step", "1e9"], "--time-step must be positive and at most 0.05 s, got 1e+09 s"),
        (["validate", "superbike", "--time-step", "0"], "--time-step must be positive and at most 0.02 s, got 0 s"),
        (["course", "plot", "barcelona", "--lateral-g", "1e9"], "--lateral-g must be positive and at most 10 g"),
    ],
)
def test_odd_values_are_refused_before_anything_starts(words, message, tmp_path, capsys):
    out = tmp_path / "out"
    assert main([*words, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith(f"bike {words[0]}: ")
    assert len(error.strip().splitlines()) == 1
    assert not out.exists()


@pytest.mark.parametrize(
    "words", [["ride"], ["evaluate"], ["lap", "--nodes"], ["validate"], ["course", "plot", "barcelona"]]
)
def test_a_folder_that_cannot_be_made_is_known_before_the_work(words, tmp_path, capsys):
    (tmp_path / "file").write_text("precious")
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        assert main([*words, "--out", str(out)]) == 2
        assert capsys.readouterr().err == f"bike {words[0]}: --out {out} cannot be a folder: a file is in the way\n"


def test_an_empty_policy_is_not_the_recorded_one(tmp_path, capsys):
    assert main(["explain", str(tmp_path / "none.mcap"), "--policy", ""]) == 2
    assert "is not a policy bundle" in capsys.readouterr().err
