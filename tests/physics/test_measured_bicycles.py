"""Twelve measured bicycles: eigenvalues of the closed formulas against the engine, and published ranges."""

from __future__ import annotations

from pathlib import Path

import pytest

from bike_sim.validation.parameters import read_parameters, validate
from bike_sim.vehicles.parameters import VehicleError

FOLDER = Path(__file__).with_name("bicycles")
STABLE = {  # m/s, of another program
    "Balanceassistv1": (3.4421, 4.3526),
    "Benchmark": (4.2924, 6.0243),
    "Browser": (4.1954, 4.3501),
    "Browserins": (4.0327, 4.2949),
    "Crescendo": (4.8046, 6.1052),
    "Fisher": (3.8040, 6.1348),
    "Pista": (3.6743, 5.4652),
    "Rigid": (5.0084, 6.4291),
    "Silver": (3.9858, 7.8956),
    "Yellow": (3.4769, 4.6842),
}


def test_eigenvalues_on_the_engine_and_the_range_of_balance() -> None:
    """The formulas know nothing of the engine's equations; the two-mass skate has no wheels to roll on it."""
    report = validate(FOLDER)
    assert [check.title for check in report.checks if not check.passed] == []
    rows = {row["bicycle"]: row for row in report.tables["bicycles"]}
    assert len(rows) == 12
    assert [name for name, row in rows.items() if row["error_1_s"] is None] == ["Tms"]
    for name, stable in STABLE.items():
        assert (rows[name]["stable_from_m_s"], rows[name]["stable_to_m_s"]) == pytest.approx(stable, abs=6e-5)


def test_what_is_no_parameter_is_refused(tmp_path: Path) -> None:
    """A line that is none, and a file that lacks one, by name."""
    text = (FOLDER / "Browser.txt").read_text(encoding="utf-8")
    for wrong, message in ((text + "xB = wide", "'xB = wide' is not"), (text.replace("mH =", "mh ="), "lack mH")):
        (tmp_path / "mine.txt").write_text(wrong, encoding="utf-8")
        with pytest.raises(VehicleError, match=message):
            read_parameters(tmp_path / "mine.txt")
