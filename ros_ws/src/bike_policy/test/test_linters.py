"""Ament's linters with the rules of the repository; `colcon test` runs this."""

from pathlib import Path

from ament_flake8.main import main_with_errors
from ament_pep257.main import main

PACKAGE = str(Path(__file__).parents[1])


def test_flake8() -> None:
    """Style, and names that are not used."""
    code, errors = main_with_errors([PACKAGE, "--config", f"{PACKAGE}/setup.cfg"])
    assert code == 0, errors


def test_pep257() -> None:
    """Form of the docstrings."""
    rules = ["--convention", "google", "--add-ignore", "D100", "D102", "D105", "D107", "D402"]
    assert main([PACKAGE, *rules]) == 0
