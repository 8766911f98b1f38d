"""Where a run rides: client, engine and number of simulators, and what follows from them."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from bike_sim.sim.batch import COMPILED_ENGINE, SUPERBIKE_ENGINE
from bike_training.learning.run_settings import COMPILED_TIME_STEP, RunSettings

DEFAULT_SIMULATORS: Final = 2
ENGINES: Final = {"local": COMPILED_ENGINE, "ros": "pybullet"}
"""Default engine of each client."""
SUPERBIKE_ENGINES: Final = {"local": SUPERBIKE_ENGINE, "ros": SUPERBIKE_ENGINE}
"""The same of superbikes."""


def with_simulator(
    settings: RunSettings,
    client: str | None = None,
    engine: str | None = None,
    time_step: float | None = None,
    simulators: int | None = None,
) -> RunSettings:
    """Return settings that ride elsewhere; what is None stays, or follows from the rest.

    Fewer bicycles at once learn as much from each of their steps.

    Args:
        settings: of a run.
        client: ``local`` or ``ros``.
        engine: kind of engine.
        time_step: integration step of simulators, s.
        simulators: how many, where the vehicles are not stepped by one compiled loop.

    Raises:
        ValueError: values that mean nothing, or nothing together.
    """
    client = client or settings.client
    engines = SUPERBIKE_ENGINES if settings.superbike else ENGINES
    engine = engine or (settings.engine if client == settings.client else engines.get(client, settings.engine))
    moved = replace(settings, client=client, engine=engine)
    if moved.compiled:
        for option, value in (("--time-step", time_step), ("--simulators", simulators)):
            if value is not None:
                raise ValueError(
                    f"{option} {value} is for simulators: add --client ros or --engine pybullet. The compiled engine "
                    f"takes steps of {COMPILED_TIME_STEP} s and as many bicycles as --set environments=N says"
                )
        return moved
    moved = replace(moved, time_step=moved.time_step if time_step is None else time_step)
    preset = settings.preset
    if simulators is None:
        simulators = min(DEFAULT_SIMULATORS, preset.environments) if settings.compiled else preset.environments
    if simulators < 1:
        raise ValueError(f"--simulators must be at least 1, got {simulators}")
    updates = max(1, round(preset.updates * simulators / preset.environments))
    return replace(moved, preset=replace(preset, environments=simulators, updates=updates))
