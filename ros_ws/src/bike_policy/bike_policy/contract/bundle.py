"""A policy bundle on disk: ``actor.safetensors`` and ``card.yaml``. No pickle is ever read."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Final

from safetensors.numpy import save_file

from bike_policy.contract.action import ActionLayout
from bike_policy.contract.actor import Actor
from bike_policy.contract.bundle_files import (
    ACTOR_FILE,
    CARD_FILE,
    FORMAT_VERSION,
    card_mapping,
    card_name,
    card_period,
    read_card,
    read_tensors,
    write_card,
)
from bike_policy.contract.observation import ObservationLayout
from bike_policy.contract.race import RACE_KIND, RaceLayout
from bike_sim.documents import shorten, show

DEFAULT_POLICY: Final = "whipple"
"""The shipped policy that rides a bicycle."""
DEFAULT_RACER: Final = "racer"
"""The shipped policy that races superbikes."""


@dataclass(frozen=True)
class Bundle:
    """An actor with everything that must be known to use it.

    Attributes:
        name: name of the bundle.
        actor: the network.
        layout: of its observation.
        action: layout of its action.
        vehicle: name of the vehicle it was trained on.
        control_period: s.
        training: how it was trained: commit, seed, steps, preset and so on.
        results: measured results with units in the names.
    """

    name: str
    actor: Actor
    layout: ObservationLayout | RaceLayout
    action: ActionLayout
    vehicle: str
    control_period: float
    training: Mapping[str, Any] = field(default_factory=dict)
    results: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse an actor whose input or output is not that of the layouts."""
        if self.actor.inputs != self.layout.size:
            raise ValueError(
                f"policy {self.name!r}: the actor takes {self.actor.inputs} numbers, its layout {self.layout.size}"
            )
        if self.actor.outputs != self.action.size:
            raise ValueError(
                f"policy {self.name!r}: the actor answers {self.actor.outputs} numbers, its action has "
                f"{self.action.size}: {', '.join(self.action.names)}"
            )

    def check_fit(self, vehicle: str, control_period: float) -> None:
        """Check that a simulator is one that this policy was made for.

        A policy of races rides other superbikes as well: it is shown what each of them can do.

        Raises:
            ValueError: naming the difference.
        """
        if vehicle != self.vehicle and not isinstance(self.layout, RaceLayout):
            raise ValueError(
                f"policy {self.name!r} was trained for vehicle {self.vehicle!r}, the simulator rides {vehicle!r}"
            )
        if abs(control_period - self.control_period) > 1e-9:
            raise ValueError(
                f"policy {self.name!r} was trained for a control period of {self.control_period} s, "
                f"the simulator's is {control_period} s"
            )

    def speed_warning(self, speed: float) -> str | None:
        """Return a warning where a speed (m/s) lies outside those that the policy was trained for, as its card says."""
        trained = self.training.get("speed_range_m_s")
        if not isinstance(trained, list) or len(trained) != 2 or trained[0] <= speed <= trained[1]:
            return None
        return f"policy {self.name!r} was trained for {trained[0]:g} to {trained[1]:g} m/s, {speed:g} m/s is outside"

    def save(self, folder: Path) -> None:
        """Write the bundle into a folder, which is made if need be."""
        folder.mkdir(parents=True, exist_ok=True)
        save_file(self.actor.tensors(), folder / ACTOR_FILE)
        (folder / ACTOR_FILE).chmod(0o644)  # safetensors makes it readable for its owner only
        card = {
            "format": FORMAT_VERSION,
            "name": self.name,
            "vehicle": self.vehicle,
            "control_period_s": self.control_period,
            "layout": self.layout.to_card(),
            "action": self.action.to_card(),
            "training": dict(self.training),
            "results": dict(self.results),
        }
        write_card(folder / CARD_FILE, card)


def layout_from_card(card: Mapping[str, Any]) -> ObservationLayout | RaceLayout:
    """Read a layout of either kind from a policy card.

    Raises:
        ValueError: it cannot be read.
    """
    if "kind" not in card:
        return ObservationLayout.from_card(card)
    if card["kind"] != RACE_KIND:
        raise ValueError(f"layout is of kind {show(str(card['kind']))}, this software knows {RACE_KIND}")
    return RaceLayout.from_card(card)


def shipped_policies() -> list[str]:
    """Return the names of the bundles that come with this package."""
    root = resources.files("bike_policy") / "policies"
    return sorted(entry.name for entry in root.iterdir() if (entry / CARD_FILE).is_file())


def load_bundle(name_or_path: str | Path) -> Bundle:
    """Load a shipped bundle by name, or any bundle by its folder.

    Raises:
        FileNotFoundError: there is no such bundle.
        ValueError: a file that is not one of this project's, or a version that this software does not speak.
    """
    folder = Path(name_or_path)
    if not os.path.isdir(folder):  # unlike Path.is_dir it answers for a name that is too long as well
        shipped = shipped_policies()
        if str(name_or_path) not in shipped:
            raise FileNotFoundError(f"no policy {show(str(name_or_path))}: neither a folder nor one of {shipped}")
        folder = Path(str(resources.files("bike_policy") / "policies")) / str(name_or_path)
    card = read_card(folder / CARD_FILE)
    tensors = read_tensors(folder / ACTOR_FILE)
    try:
        return Bundle(
            name=card_name(card, "name"),
            actor=Actor.from_tensors(tensors),
            layout=layout_from_card(card_mapping(card, "layout")),
            action=ActionLayout.from_card(card_mapping(card, "action")),
            vehicle=card_name(card, "vehicle"),
            control_period=card_period(card),
            training=card_mapping(card, "training"),
            results=card_mapping(card, "results"),
        )
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"{folder}: {shorten(str(error))}") from error
