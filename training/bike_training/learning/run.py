"""One run of learning from its settings to its summary: what `bike train` and whoever runs many of them call."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any, Final

from bike_training.arguments import write_whole
from bike_training.envs.node_process import NodeLost
from bike_training.learning.checkpoint import find_checkpoint
from bike_training.learning.presets import GradientSettings
from bike_training.learning.process import LearningProcess
from bike_training.learning.run_settings import RunSettings
from bike_training.settings import to_plain

SETTINGS_FILE: Final = "settings.json"


def run(
    settings: RunSettings,
    out: Path,
    report: Callable[[LearningProcess], None] | None = None,
    resume: bool = False,
) -> dict[str, Any]:
    """Learn until the run has ended or is stopped.

    Args:
        settings: of the run; its result depends on them alone.
        out: its folder.
        report: called after each step of all vehicles, to show progress.
        resume: go on from the checkpoint in ``out``.

    Returns:
        The summary, as in ``run.json``, with ``interrupted``: whether a signal stopped the run before its end.

    Raises:
        FileNotFoundError: nothing to resume from, or an unknown vehicle.
        ValueError: the folder holds another run, what it holds cannot be read, or settings that do not fit together.
        NodeLost: a simulator behind ROS did not start or was lost.
    """
    if isinstance(settings.preset.learner, GradientSettings):
        raise ValueError(f"preset {settings.preset.name!r} learns by gradients; see `learn_by_gradients`")
    interrupted = False
    try:
        with closing(LearningProcess(settings, out, settings.preset.sac.steps, resume=resume)) as process:
            # Only now: nothing stays of a run that cannot be.
            write_whole(out / SETTINGS_FILE, json.dumps(to_plain(settings), indent=1))
            try:
                process.run(report)
            except KeyboardInterrupt:
                interrupted = True
    except NodeLost as error:
        if find_checkpoint(out) is None:
            raise
        raise NodeLost(f"{error}; go on from the checkpoint in {out} with --resume") from error
    return process.summary() | {"interrupted": interrupted}


def stored_settings(out: Path) -> RunSettings:
    """Return the settings of the run in a folder.

    Raises:
        FileNotFoundError: it holds none. ValueError: they cannot be read.
    """
    path = out / SETTINGS_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{out} holds no run to resume ({path.name} is missing)")
    try:
        return RunSettings.from_plain(json.loads(path.read_text(encoding="utf-8")))
    except ValueError as error:
        raise ValueError(
            f"{path} cannot be read ({error}); it is damaged, or another version of this software wrote it"
        ) from error
