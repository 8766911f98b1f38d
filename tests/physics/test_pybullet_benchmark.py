"""What `bike validate` measures, held: every check of both engines, at the steps they are used with."""

import functools
import json
import math

import pytest

from bike_sim.validation import bicycle as validation
from bike_sim.validation import superbike
from bike_sim.validation.report import Check, Report
from bike_sim.vehicles.files import SHIPPED, load_vehicle
from bike_training import cli
from bike_training.commands import validate as command

VEHICLE = load_vehicle("whipple")


measure = validation.validate


@functools.cache
def validated(kind: str, time_step: float) -> Report:
    return measure(VEHICLE, kind, time_step)


@pytest.mark.parametrize(("kind", "time_step"), [("pybullet", 0.001), ("pybullet", 0.005), ("whipple", 0.005)])
def test_every_published_figure_is_met(kind: str, time_step: float) -> None:
    result = validated(kind, time_step)
    missed = [f"{check.name} = {check.measured:.5g}" for check in result.checks if not check.passed]
    assert not missed
    assert len(result.checks) >= 13


def test_a_spoilt_engine_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    # Contacts solved too sloppily, as Bullet's defaults would: the checks must notice.
    monkeypatch.setattr("bike_sim.physics.bicycle.bullet._FRICTION", 0.5)
    monkeypatch.setattr("bike_sim.physics.bicycle.bullet._MARGIN", 0.002)
    checks = validation.stability_limits(validation.Run(VEHICLE, "pybullet", 0.001))
    assert "capsize_speed_m_s" in {check.name for check in checks if not check.passed}


def test_nan_does_not_pass() -> None:
    assert not Check("x", "x", math.nan, 0.0, 1.0).passed


def test_command_prints_writes_and_returns_the_figures(
    tmp_path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(validation, "validate", lambda vehicle, kind, time_step, *_: validated(kind, time_step))
    answer = command.run(cli.parse("validate", ["--time-step", "0.005", "--out", str(tmp_path / "new")]))
    assert answer["schema"] == "bike.validate/1"
    assert answer["ok"] is True
    assert answer["figures"]["weave_speed_m_s"] == pytest.approx(4.292, rel=0.01)
    assert [entry["speed_m_s"] for entry in answer["figures"]["modes"][::2]] == [3.0, 4.0, 5.0, 6.0, 7.0, 8.0]
    assert json.loads((tmp_path / "new" / "validate.json").read_text()) == answer
    assert (tmp_path / "new" / "modes.png").read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "weave speed, m/s" in printed
    assert "FAIL" not in printed


def test_command_is_silent_for_json(capsys: pytest.CaptureFixture[str]) -> None:
    json.dumps(command.run(cli.parse("validate", ["--engine", "whipple", "--time-step", "0.005", "--json"])))
    assert capsys.readouterr().out == ""


def test_unknown_vehicle_is_one_clear_error() -> None:
    with pytest.raises(FileNotFoundError, match="no_such_bike"):
        cli.parse("validate", ["--vehicle", "no_such_bike"])


def test_a_superbike_of_its_own_file_is_measured(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    content = (SHIPPED / "r1.yaml").read_text(encoding="utf-8")
    (tmp_path / "mine.yaml").write_text(content.replace("name: r1", "name: mine"), encoding="utf-8")
    monkeypatch.setattr(superbike, "PARTS", [("mirror symmetry", superbike.check_mirror)])
    monkeypatch.setattr(command, "bound_checks", lambda names: iter(()))
    monkeypatch.setattr(command, "add_laps", lambda report, names: report)
    monkeypatch.setattr(superbike, "MODE_SPEEDS", (40.0,))
    args = cli.parse("validate", ["--vehicle", str(tmp_path / "mine.yaml"), "--json"])
    answer = command.run_superbikes(args)
    assert [row["vehicle"] for row in answer["figures"]["performance"]] == ["mine"]
    assert (answer["schema"], answer["ok"]) == ("bike.validate_superbike/1", True)
    assert answer["figures"]["mirror_lean_deg"] < 1e-6
