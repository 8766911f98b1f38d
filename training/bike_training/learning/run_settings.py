"""Settings of a learning run: its preset, simulators, seed and output."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from bike_sim.documents import show
from bike_sim.physics.engines import ENGINE_KINDS
from bike_sim.sim.batch import COMPILED_ENGINE, SUPERBIKE_ENGINE
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.envs.clients import CLIENT_KINDS
from bike_training.learning.presets import LARGEST_SEED, GradientSettings, Preset, load_preset
from bike_training.settings import AT_LEAST_0, AT_LEAST_1, POSITIVE, Settings, check_choice, from_plain

COMPILED_TIME_STEP: Final = 0.01
"""Integration step of the compiled engine in training, s; its error there is below 1e-6 in every state."""

RECORD_ENDS: Final = 1_000_000_000
"""Validations between recorded rides where the first and the last alone are recorded."""

GRADIENT_TABLE: Final = "refinement.csv"
"""File of a run that learns by gradients: a row for each comparison of actors."""
IMITATED: Final = "imitated.safetensors"
"""File of a run with the actor that it begins with, learned by imitation."""
GRADIENT_POLICY: Final = "policy"
"""Its bundle of the best actor."""

TRAINING_DRAWS, VALIDATION_DRAWS = 0, 1
"""Branches of a run's seed, so that no draw of a run is another draw of it or of a run with another seed."""


DEFAULT_PRESET: Final = "fast"
DEFAULT_SIMULATORS: Final = 2
ENGINES: Final = {"local": COMPILED_ENGINE, "ros": "pybullet"}
"""Default engine of each client."""
SUPERBIKE_ENGINES: Final = {"local": SUPERBIKE_ENGINE, "ros": SUPERBIKE_ENGINE}
"""The same of superbikes."""


FINISH_STEPS: Final = 100_000
"""Steps after which the default preset has finished its curriculum, mostly (docs/reference/results.md)."""


def machines_of(vehicle: str) -> tuple[str, ...]:
    """Return the names or files of the vehicles of a run from its setting, in which commas part them."""
    return tuple(name.strip() for name in vehicle.split(","))


@dataclass(frozen=True)
class RunSettings(Settings):
    """Settings of a run, beside its preset.

    Attributes:
        preset: settings of the learner, the task and the curriculum.
        vehicle: name of a shipped vehicle, or path of its file; of races several with commas between them, which the
            rows take in turn.
        seed: seed of everything.
        client: ``local`` or ``ros``.
        engine: a kind of :func:`bike_sim.physics.engines.make_engine`.
        time_step: integration step of a bicycle's simulator, s; the compiled batch uses COMPILED_TIME_STEP, and
            superbikes have their own.
        checkpoint_every: learning steps between checkpoints.
        record_every: validations between recorded rides, the last one besides; 0 records none.
        until_finished: stop when the curriculum is finished.
        keep_every: learning steps between actors that are kept in ``actors/``; 0 keeps those that are compared alone.
        start: policy that the learner ``gradients`` begins with; empty for a new network.
    """

    limits: ClassVar = {
        "seed": (0, LARGEST_SEED),
        "time_step": POSITIVE,
        "checkpoint_every": AT_LEAST_1,
        **dict.fromkeys(("keep_every", "record_every"), AT_LEAST_0),
    }

    preset: Preset = field(default_factory=lambda: load_preset(DEFAULT_PRESET))
    vehicle: str = "whipple"
    seed: int = 0
    client: str = "local"
    engine: str = COMPILED_ENGINE
    time_step: float = 0.005
    checkpoint_every: int = 50_000
    record_every: int = 0
    until_finished: bool = False
    keep_every: int = 0
    start: str = ""

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        super().__post_init__()
        check_choice("client", self.client, CLIENT_KINDS)
        check_choice("engine", self.engine, ENGINE_KINDS)
        if self.start and not isinstance(self.preset.learner, GradientSettings):
            raise ValueError(
                f"start {self.start!r} is for the learner gradients, not for {self.preset.learner.learner}"
            )

    def expected_steps(self, made: int = 0) -> int:
        """Return the learning steps that it will make in all, as far as can be said after those already made."""
        steps = self.preset.sac.steps
        return min(steps, max(FINISH_STEPS, round(1.1 * made))) if self.until_finished else steps

    @classmethod
    def from_plain(cls, stored: Any) -> RunSettings:
        """Return the settings of a table, as `to_plain` makes it.

        Raises:
            ValueError: an entry is missing, unknown, or of another kind.
        """
        if not isinstance(stored, dict):
            raise ValueError(f"a run must be a table of settings, got {show(stored)}")
        return from_plain(cls, {**stored, "preset": Preset.from_plain(stored.get("preset"))}, "a run")

    @property
    def compiled(self) -> bool:
        """Whether all vehicles are stepped by one compiled loop in this process."""
        engine = SUPERBIKE_ENGINE if self.superbike else COMPILED_ENGINE
        return self.client == "local" and self.engine == engine

    @property
    def machines(self) -> tuple[str, ...]:
        """Names or files of the vehicles, which the rows take in turn."""
        return machines_of(self.vehicle)

    @property
    def superbike(self) -> bool:
        """Whether superbikes learn."""
        return isinstance(load_vehicle(self.machines[0]), Superbike)

    def simulator(self, row: int = 0) -> SimulatorConfig:
        """Return the configuration of a simulator that rides as a row of the environments does."""
        found = self.compiled_simulator(row)
        if self.compiled:
            return found
        return replace(found, engine=self.engine, time_step=found.time_step if self.superbike else self.time_step)

    def compiled_simulator(self, row: int = 0) -> SimulatorConfig:
        """Return the configuration of the compiled engine, on which actors are compared wherever they learn."""
        machine = self.machines[row % len(self.machines)]
        if self.superbike:
            return replace(superbike_config(machine), engine=SUPERBIKE_ENGINE)
        return SimulatorConfig(machine, COMPILED_ENGINE, COMPILED_TIME_STEP)


def draws(seed: int, branch: int, step: int = 0) -> np.random.SeedSequence:
    """Return the seeds of a run's draws.

    Args:
        seed: seed of the run.
        branch: TRAINING_DRAWS or VALIDATION_DRAWS.
        step: learning step from which on they are drawn, so that a run whose rides begin anew has new ones.
    """
    return np.random.SeedSequence(seed, spawn_key=(branch, step))


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
                    f"takes steps of {COMPILED_TIME_STEP} s and as many bicycles as --set learner.environments=N says"
                )
        return moved
    moved = replace(moved, time_step=moved.time_step if time_step is None else time_step)
    learner = settings.preset.sac
    if simulators is None:
        simulators = min(DEFAULT_SIMULATORS, learner.environments) if settings.compiled else learner.environments
    if simulators < 1:
        raise ValueError(f"--simulators must be at least 1, got {simulators}")
    updates = max(1, round(learner.updates * simulators / learner.environments))
    changes = {"learner.environments": simulators, "learner.updates": updates}
    return replace(moved, preset=settings.preset.changed(changes))


def settings_of(entries: Mapping[str, Any], record_every: int) -> RunSettings:
    """Return the settings of a new run.

    Args:
        entries: options of `bike train` by name, those of ``--set`` under ``set``; what is None or missing has its
            default.
        record_every: where it is not among them.

    Raises:
        FileNotFoundError: an unknown vehicle.
        ValueError: an unknown setting, or values that mean nothing, or nothing together.
    """
    given = {name: value for name, value in entries.items() if value is not None}
    preset = load_preset(given.get("preset", DEFAULT_PRESET)).changed(given.get("set", {}))
    if "steps" in given:
        preset = preset.changed({"learner.steps": given["steps"]})
    names = ("vehicle", "seed", "until_finished", "checkpoint_every", "record_every", "keep_every", "start")
    chosen = {"record_every": record_every, **{name: given[name] for name in names if name in given}}
    begun = RunSettings(preset, **chosen)
    if begun.superbike:
        begun = replace(begun, engine=SUPERBIKE_ENGINES["local"])
    return with_simulator(begun, *(given.get(name) for name in ("client", "engine", "time_step", "simulators")))


def source_commit() -> str:
    """Return the commit of the sources, with ``-dirty`` for changed ones, or ``unknown`` outside a checkout."""
    here = Path(__file__).parent
    command = ["git", "-C", str(here), "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
