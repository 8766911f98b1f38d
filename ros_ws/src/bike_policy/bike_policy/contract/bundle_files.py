"""The files of a policy bundle, read as untrusted input.

They must be regular files of limited size before anything is parsed, so that none makes a reader wait or fills its
memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load

from bike_sim.documents import (
    MAX_YAML_SIZE,
    DocumentError,
    check_name,
    parse_yaml,
    read_bytes,
    read_text,
    shorten,
    show,
)

FORMAT_VERSION: Final = 1
ACTOR_FILE: Final = "actor.safetensors"
CARD_FILE: Final = "card.yaml"
MAX_ACTOR_SIZE: Final = 64_000_000
"""Largest file of an actor, bytes: 16 million numbers; the shipped one has 19 thousand."""
MAX_PERIOD: Final = 10.0
"""Longest control period, s."""
_CARD_ENTRIES: Final = ("format", "name", "vehicle", "control_period_s", "layout", "action", "training", "results")


def read_card(path: Path) -> dict[str, Any]:
    """Read a card, every entry of which is there.

    Raises:
        FileNotFoundError: it does not exist. ValueError: it is not a card of this format.
    """
    try:
        card = parse_yaml(read_text(path, MAX_YAML_SIZE))
    except FileNotFoundError:
        raise FileNotFoundError(f"{path.parent} is not a policy bundle: it has no {CARD_FILE}") from None
    except DocumentError as error:
        raise ValueError(f"{path} {error}") from None
    if not isinstance(card, dict) or card.get("format") != FORMAT_VERSION:
        found = card.get("format") if isinstance(card, dict) else type(card).__name__
        raise ValueError(f"{path}: policy format {show(found)}, this software reads format {FORMAT_VERSION}")
    missing = [entry for entry in _CARD_ENTRIES if entry not in card]
    if missing:
        raise ValueError(f"{path}: the card lacks {missing}")
    return card


def read_tensors(path: Path) -> dict[str, NDArray[np.float32]]:
    """Read named tensors as single precision.

    Raises:
        FileNotFoundError: there is no such file. ValueError: it is no safetensors file.
    """
    try:
        tensors = load(read_bytes(path, MAX_ACTOR_SIZE))
    except FileNotFoundError:
        raise FileNotFoundError(f"{path.parent} is not a policy bundle: it has no {ACTOR_FILE}") from None
    except (SafetensorError, KeyError, TypeError) as error:  # KeyError: a type of numbers that NumPy lacks
        raise ValueError(f"{path}: not a safetensors file of an actor ({shorten(str(error))})") from None
    except DocumentError as error:
        raise ValueError(f"{path} {error}") from None
    with np.errstate(over="ignore"):  # beyond single precision is infinite, and the actor refuses that
        return {key: np.asarray(value, dtype=np.float32) for key, value in tensors.items()}


class _CardDumper(yaml.SafeDumper):
    """Safe dumper that writes out what stands in a card twice, where YAML would use an alias."""

    def ignore_aliases(self, data: Any) -> bool:
        """Use no aliases."""
        return True


def write_card(path: Path, card: Mapping[str, Any]) -> None:
    """Write a card as `read_card` reads it."""
    path.write_text(yaml.dump(card, Dumper=_CardDumper, sort_keys=False, width=100), encoding="utf-8")


def card_name(card: Mapping[str, Any], key: str) -> str:
    """Return a name from a card, which is short and can be shown."""
    return check_name(card[key], f"{key} of the card")


def card_mapping(card: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return a mapping from a card."""
    value = card[key]
    if not isinstance(value, dict):
        raise ValueError(f"{key} of the card must be a mapping, got {show(value)}")
    return value


def card_period(card: Mapping[str, Any]) -> float:
    """Return the control period of a card, s."""
    value = card["control_period_s"]
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= MAX_PERIOD:
        raise ValueError(
            f"control_period_s of the card must be a number above 0 and at most {MAX_PERIOD:g} s, got {show(value)}"
        )
    return float(value)
