"""One run of a sweep in its process: it goes on, and it fails in one line."""

from __future__ import annotations

import resource
import shutil
import signal
from pathlib import Path

import pytest

from bike_training.learning.process import run as learn
from bike_training.learning.run_settings import RECORD_ENDS
from bike_training.sweeps.results import curves_table, runs_table
from bike_training.sweeps.runs import FAILED, FINISHED, INTERRUPTED, execute, make_plan, result_of, status_of
from bike_training.sweeps.spec import sweep_from_document

from .conftest import assert_same, learned, tiny

SWEEP = sweep_from_document(tiny(grid={"seed": [3, 4]}))
RUN = SWEEP.runs[0]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the run, done in one go."""
    folder = tmp_path_factory.mktemp("whole")
    assert execute(RUN, folder)["status"] == FINISHED
    return folder


def test_a_run_of_a_sweep_is_that_training_bit_for_bit(whole: Path, tmp_path: Path) -> None:
    summary = learn(RUN.job().settings, tmp_path)
    assert result_of(whole)["figures"]["updates"] == summary["updates"] > 0
    assert RUN.job().settings.record_every == RECORD_ENDS  # the first validation and the last, if it makes any
    assert_same(learned(whole), learned(tmp_path))


def test_a_run_that_was_interrupted_goes_on_and_ends_as_if_it_had_not_been(whole: Path, tmp_path: Path) -> None:
    def stop(done: float, total: float, words: str) -> None:
        signal.raise_signal(signal.SIGINT)

    stopped = execute(RUN, tmp_path / "parts", report=stop)
    assert stopped["status"] == INTERRUPTED
    assert status_of(tmp_path / "parts") == (INTERRUPTED, "")
    assert execute(RUN, tmp_path / "parts")["attempts"] == 2
    assert_same(learned(tmp_path / "parts"), learned(whole))


def test_a_finished_run_is_not_done_again(whole: Path) -> None:
    written = (whole / "run.json").stat().st_mtime_ns
    assert execute(RUN, whole) == result_of(whole)
    assert (whole / "run.json").stat().st_mtime_ns == written


def test_a_full_disk_fails_in_one_line_and_the_run_goes_on_later(whole: Path, tmp_path: Path) -> None:
    """No file of this process may grow beyond a limit: what a write then gets is what it gets on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handled = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        record = execute(RUN, tmp_path / "run")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handled)
    assert record["status"] == FAILED
    assert "\n" not in record["error"]
    assert "File too large" in record["error"]
    assert status_of(tmp_path / "run") == (FAILED, record["error"])
    assert execute(RUN, tmp_path / "run")["status"] == FINISHED
    assert_same(learned(tmp_path / "run"), learned(whole))


def test_tables_have_every_run_and_the_points_of_its_curves(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "runs" / RUN.name)
    plan = make_plan(SWEEP, tmp_path)
    runs, curves = runs_table(plan), curves_table(plan)
    assert list(runs["status"]) == [FINISHED, "missing"]
    assert list(runs["seed"]) == [3, 4]
    assert runs["figure_updates"][0] == result_of(tmp_path / "runs" / RUN.name)["figures"]["updates"]
    assert runs["group"].nunique() == 1
    rows = (tmp_path / "runs" / RUN.name / "validations.csv").read_text().splitlines()[1:]
    errors = curves[curves["quantity"] == "mean_error_m"]
    assert list(errors["value"]) == [float(row.split(",")[3]) for row in rows]
