"""Presets: what they hold is written down here and in the document, and every form of them comes back as it was."""

import json
import re
from pathlib import Path

import pytest

from bike_sim.documents import parse_yaml
from bike_sim.sim.batch import COMPILED_ENGINE
from bike_training.learning.presets import KINDS, Preset, load_preset, preset_names
from bike_training.learning.process import LearningProcess
from bike_training.learning.run_settings import RunSettings
from bike_training.settings import paths_of
from bike_training.tasks.path import TASKS

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "training.md"
FAST, PAPER = load_preset("fast"), load_preset("paper")

SHARP = {"path_linear": 0.5, "path_peak": 0.5}
PUBLISHED_RACE = {
    **{"progress": 1.0, "off_track": 1.0, "wall": 5e-4, "overspeed": 1.0, "fall": 10.0, "max_lean": 20.0},
    **{"steer_change": 3.0, "lean_change": 1.0, "rate_change": 0.1, "steer_history": 0.5, "lean_history": 0.5},
    **{"slip_ratio": 1.0, "slip_angle": 1.0, "motion": 0.05},
}
"""Weights of the reward's terms in the superbike paper."""


def documented() -> dict[str, tuple[str | None, str | None]]:
    """Return the values of `paper` and `fast` in the document's table, by path; None where it has no literal."""
    section = DOCUMENT.read_text(encoding="utf-8").split("## The default preset")[1].split("\n## ")[0]
    found = {}
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split(" | ")]
        paths = re.findall(r"`([\w.]+)`", cells[0])
        if len(cells) == 3 and paths:
            literals = [re.match(r"`([^`]+)`", cell) for cell in cells[1:3]]
            path = f"{paths[0]}.{paths[0]}" if paths[0] in KINDS else paths[0]
            found[path] = tuple(literal and literal[1] for literal in literals)
    return found


def value_at(preset: Preset, path: str) -> object:
    value = preset.to_plain()
    for name in path.split("."):
        value = value[name]
    return value


def test_presets_of_the_papers_are_theirs() -> None:
    """Bicycles: 4 million steps of the original learner (Weyrer et al. 2026); superbikes: Sect. VI of theirs."""
    for name in preset_names():
        preset = load_preset(name)
        if preset.published:
            assert (preset.sac.learner, preset.sac.steps) == ("sb3", 4_000_000)
            assert preset.task == TASKS["prop" if name == "paper" else name]
    race = load_preset("race_paper")
    assert dict(race.task.weights) == PUBLISHED_RACE
    assert (race.sac.steps, race.sac.batch_size, race.task.max_steps, race.task.repeat) == (1900 * 5000, 512, 7500, 1)
    assert (race.curriculum.curriculum, race.curriculum.start_line) == ("spdl", True)


def test_the_document_lists_what_differs_between_the_presets() -> None:
    differing = {path for path in paths_of(FAST.to_plain()) if value_at(FAST, path) != value_at(PAPER, path)} - {"name"}
    assert set(documented()) == differing


@pytest.mark.parametrize("path", sorted(documented()))
def test_the_values_in_the_document_are_those_of_the_presets(path: str) -> None:
    for preset, literal in zip((PAPER, FAST), documented()[path], strict=True):
        assert literal is not None
        assert preset.changed({path: literal}) == preset


def test_what_the_document_says_of_both_presets_is_so() -> None:
    said = DOCUMENT.read_text(encoding="utf-8").split("The same in both: ")[1].split(".\n")[0].split(". Reasons")[0]
    pairs = re.findall(r"`([\w.]+)`\s+(\S+?)(?:,|\s|$)", said)
    assert len(pairs) >= 7
    for path, text in pairs:
        for preset in (PAPER, FAST):
            assert preset.changed({path: text}) == preset


@pytest.mark.parametrize("name", preset_names())
def test_a_preset_comes_back_from_json_and_from_a_file(name: str, tmp_path: Path) -> None:
    preset = load_preset(name)
    plain = json.dumps(preset.to_plain())
    assert Preset.from_plain(json.loads(plain)) == preset
    (tmp_path / f"{name}.yaml").write_text(plain)
    assert load_preset(str(tmp_path / f"{name}.yaml")) == preset
    assert Preset.from_plain(parse_yaml(plain)) == preset


def test_settings_are_changed_by_path() -> None:
    changed = FAST.changed(
        {"learner.gamma": "0.5", "task.weights.upright": "0.25", "curriculum.refine": "false", "learner.layers": "8,9"}
    )
    assert (changed.sac.gamma, changed.sac.layers) == (0.5, (8, 9))
    assert changed.task.weights == {**SHARP, "upright": 0.25}
    assert changed == FAST.changed(
        {"learner": "sbx", "learner.gamma": 0.5, "learner.layers": [8, 9], "curriculum.refine": False}
        | {"task.weights": {**SHARP, "upright": 0.25}}
    )


def test_another_kind_keeps_what_both_have_and_its_own_defaults() -> None:
    direct = load_preset("race_direct")
    spdl = direct.changed({"curriculum": "spdl", "curriculum.kl": "0.1"})
    assert spdl.to_plain()["curriculum"] == {
        **direct.to_plain()["curriculum"],
        **{"curriculum": "spdl", "kl": 0.1, "threshold": 500.0, "iteration": 5000},
    }
    assert PAPER.changed({"task": "alt4"}).task == load_preset("alt4").task


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gama": "0.5"}, r"no setting 'gama'; .*are .*task\.sharpness.*learner\.gamma"),
        ({"learner.gama": "0.5"}, "no setting 'learner.gama'"),
        ({"curriculum.kl": "0.1"}, "no setting 'curriculum.kl'"),
        ({"learner.gamma.x": "0.1"}, "no setting 'learner.gamma.x'"),
        ({"learner.layers": "8,many"}, "learner.layers"),
        ({"learner.steps": "1.5"}, "learner.steps=1.5 is not a whole number"),
        ({"learner.mirror": "1"}, "learner.mirror=1 is not a truth value"),
        ({"task.weights": "3"}, "task.weights=3 is not a table of numbers"),
        ({"curriculum": "spdl", "curriculum.kl": "-1"}, "curriculum.kl=-1.0 must be positive"),
    ],
)
def test_changes_that_mean_nothing_are_refused(changes: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FAST.changed(changes)


@pytest.mark.parametrize(
    ("stored", "message"),
    [
        ({"task": "prop"}, "task must be a table of settings, got 'prop'"),
        ({"task": {"task": "swim"}}, "task='swim' is not known; there are"),
        ({"task": {"task": "prop", "depth": 1}}, "task has no setting 'depth'"),
        ({"curriculum": {"curriculum": "parts", "refine": 3}}, "curriculum.refine=3 is not a truth value"),
        ({"layers": [8]}, "a preset has no setting 'layers'"),
        ({"name": 3}, "name of a preset must be text"),
    ],
)
def test_tables_of_other_records_are_refused(stored: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Preset.from_plain({**PAPER.to_plain(), **stored})


def test_a_task_for_bicycles_refuses_a_superbike(tmp_path: Path) -> None:
    settings = RunSettings(PAPER, vehicle="panigale_v4r", engine=COMPILED_ENGINE)
    with pytest.raises(ValueError, match=r"'prop' is for bicycles on paths, and '.*' is a superbike"):
        LearningProcess(settings, tmp_path / "run", 10)
    assert not (tmp_path / "run").exists()


def test_the_papers_presets_are_told_from_those_made_of_them() -> None:
    """The paper deploys the last actor that passed a validation, so `bike export` does so for these presets only."""
    published = {name for name in preset_names() if load_preset(name).published}
    assert published == {"paper", "alt1", "alt2", "alt3", "alt4", "alt5"}
