"""Presets: the document says what they are, and their cards and texts come back as they were."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from bike_sim.sim.batch import COMPILED_ENGINE
from bike_training.learning.presets import FAST, PAPER, PRESETS, Preset
from bike_training.learning.process import LearningProcess
from bike_training.learning.run_settings import RunSettings
from bike_training.learning.setting_records import parse

DOCUMENT = Path(__file__).parents[2] / "docs" / "training.md"


def documented() -> dict[str, tuple[str | None, str | None]]:
    """Return the values of `paper` and `fast` in the document's table, by setting."""
    section = DOCUMENT.read_text(encoding="utf-8").split("## The default preset")[1].split("\n## ")[0]
    found = {}
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split(" | ")]
        names = re.findall(r"`(\w+)`", cells[0])
        if len(cells) == 4 and names:
            literals = [re.match(r"`([^`]+)`", cell) for cell in cells[1:3]]
            found[names[0]] = tuple(literal and literal[1] for literal in literals)
    return found


def test_the_document_lists_what_differs_between_the_presets():
    paper, fast = PAPER.settings(), FAST.settings()
    differing = {name for name in paper if paper[name] != fast[name]} - {"name"}
    # `task` holds the name of the task once flat, and the settings of tasks and curricula stand for themselves.
    assert set(documented()) == differing


@pytest.mark.parametrize("name", sorted(documented()))
def test_the_values_in_the_document_are_those_of_the_presets(name):
    for preset, literal in zip((PAPER, FAST), documented()[name], strict=True):
        value = preset.settings()[name]
        value = tuple(value) if isinstance(value, list) else value
        assert parse(name, literal, value) == value


def test_what_the_document_says_of_both_presets_is_so():
    said = DOCUMENT.read_text(encoding="utf-8").split("The same in both: ")[1].split(".\n")[0].split(". Reasons")[0]
    pairs = re.findall(r"`(\w+)`\s+(\S+?)(?:,|\s|$)", said)
    assert len(pairs) >= 7
    for name, text in pairs:
        for preset in (PAPER, FAST):
            assert parse(name, text, preset.settings()[name]) == preset.settings()[name]


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_a_card_comes_back(preset):
    assert Preset.from_card(json.loads(json.dumps(preset.to_card()))) == preset


def test_settings_are_changed_by_name_in_every_record():
    changed = FAST.override({"gamma": "0.5", "task": "alt3", "sharpness": "0.3", "refine": "false", "layers": "8,9"})
    assert (changed.gamma, changed.layers) == (0.5, (8, 9))
    assert changed.task == replace(FAST.task, task="alt3", sharpness=0.3)
    assert changed.curriculum == replace(FAST.curriculum, refine=False)
    assert changed.task.contact == "front"
    with pytest.raises(ValueError, match=r"no setting 'gama'; it has .*'refine'.*'sharpness'"):
        FAST.override({"gama": "0.5"})


@pytest.mark.parametrize(
    ("card", "message"),
    [
        ({"task": "prop"}, "entry task is 'prop'"),
        ({"task": {"task": "swim"}}, "entry task is 'swim'"),
        ({"task": {"task": "prop", "depth": 1}}, "unknown entries"),
        ({"curriculum": {"curriculum": "parts", "refine": 3}}, "entry refine is 3"),
    ],
)
def test_cards_of_other_records_are_refused(card, message):
    with pytest.raises(ValueError, match=message):
        Preset.from_card({**PAPER.to_card(), **card})


def test_a_task_for_bicycles_refuses_a_superbike(tmp_path):
    settings = RunSettings(PAPER, vehicle="panigale_v4r", engine=COMPILED_ENGINE)
    with pytest.raises(ValueError, match=r"'prop' is for bicycles on paths, and '.*' is a superbike"):
        LearningProcess(settings, tmp_path / "run", 10)
    assert not (tmp_path / "run").exists()


def test_the_papers_presets_are_told_from_those_made_of_them():
    """The paper deploys the last actor that passed a validation, so `bike export` does so for these presets only."""
    published = {name for name, preset in PRESETS.items() if preset.published}
    assert published == {"paper", "alt1", "alt2", "alt3", "alt4", "alt5"}
