"""A search draws settings, stops what is hopeless, and goes on where it was stopped."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bike_training.sweeps.search import standing
from bike_training.sweeps.spec import METRICS

from .conftest import TINY, tiny

pytest.importorskip("ray")
SPACE = {"learner.gamma": {"uniform": [0.9, 0.999]}, "learner.layers": {"choice": [[8], [16, 16]]}}


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_search_tries_settings_and_tells_the_best(tmp_path: Path, write, drive) -> None:
    base = {"vehicle": "whipple", "steps": 4000, "set": TINY}
    spec = write(tiny(base=base, search={"settings": SPACE, "trials": 3, "grace_steps": 2000, "reduction": 2}))
    driver = drive(spec, tmp_path / "out", "--search", "--json")
    assert driver.end() == 0, driver.words.read_text()
    figures = json.loads(driver.words.read_text().strip().splitlines()[-1])["figures"]
    trials = figures["trials"]
    assert len(trials) == 3
    assert all(0.9 <= trial["settings"]["learner.gamma"] <= 0.999 and trial["steps"] >= 2000 for trial in trials)
    assert len({trial["settings"]["learner.gamma"] for trial in trials}) == 3
    assert figures["best"]["value"] == max(trial["value"] for trial in trials)
    again = drive(spec, tmp_path / "out", "--search", "--json")
    assert again.end() == 0
    assert json.loads(again.words.read_text().strip().splitlines()[-1])["figures"] == figures


class _Finished:
    """A training at its end, as far as a search looks at it."""

    class progress:
        recent_error_m = 0.1

        class curriculum:
            part = 4
            finished_at: int | None = None

    class model:
        ep_info_buffer = ({"l": 600}, {"l": 1200})

    class task:
        max_steps = 1200

    steps = 1000


def test_the_earlier_it_finishes_the_further_it_came() -> None:
    process = _Finished()
    unfinished = standing(process)  # type: ignore[arg-type]
    assert set(unfinished) == set(METRICS)
    assert unfinished["advance"] == pytest.approx(4.75)
    came = []
    for step in (900, 300):
        process.progress.curriculum.finished_at = step
        came.append(standing(process)["advance"])  # type: ignore[arg-type]
    process.progress.curriculum.finished_at = None
    assert unfinished["advance"] < came[0] < came[1]
