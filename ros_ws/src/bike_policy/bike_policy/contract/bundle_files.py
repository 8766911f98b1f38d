"""The files of a policy bundle, read as untrusted input.

They must be regular files of limited size before anything is parsed, so that none makes a reader wait or fills its
memory. The few lines for this repeat those of `bike_sim.documents`, because the contract imports no
simulator.
"""

from __future__ import annotations

import os
import stat
import unicodedata
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load

FORMAT_VERSION: Final = 1
ACTOR_FILE: Final = "actor.safetensors"
CARD_FILE: Final = "card.yaml"
MAX_ACTOR_SIZE: Final = 64_000_000
"""Largest file of an actor, bytes: 16 million numbers; the shipped one has 19 thousand."""
MAX_CARD_SIZE: Final = 250_000
"""Largest card, bytes."""
MAX_PERIOD: Final = 10.0
"""Longest control period, s."""
MAX_NAME: Final = 200
"""Longest name of a bundle or vehicle, characters."""
_CARD_ENTRIES: Final = ("format", "name", "vehicle", "control_period_s", "layout", "action", "training", "results")


def read_card(path: Path) -> dict[str, Any]:
    """Read a card, every entry of which is there.

    Raises:
        FileNotFoundError: it does not exist. ValueError: it is not a card of this format.
    """
    try:
        text = _read_file(path, MAX_CARD_SIZE).decode("utf-8")
        card = yaml.load(text, Loader=_CardLoader)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path.parent} is not a policy bundle: it has no {CARD_FILE}") from None
    except RecursionError:
        raise ValueError(f"{path}: is nested too deeply") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a YAML file ({cut(str(error))})") from None
    except ValueError as error:  # the file's own, or an invalid date or number
        raise ValueError(f"{path}: {cut(str(error))}") from None
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
        tensors = load(_read_file(path, MAX_ACTOR_SIZE))
    except FileNotFoundError:
        raise FileNotFoundError(f"{path.parent} is not a policy bundle: it has no {ACTOR_FILE}") from None
    except (SafetensorError, KeyError, TypeError) as error:  # KeyError: a type of numbers that NumPy lacks
        raise ValueError(f"{path}: not a safetensors file of an actor ({cut(str(error))})") from None
    except ValueError as error:
        raise ValueError(f"{path}: {cut(str(error))}") from None
    with np.errstate(over="ignore"):  # beyond single precision is infinite, and the actor refuses that
        return {key: np.asarray(value, dtype=np.float32) for key, value in tensors.items()}


def _read_file(path: Path, limit: int) -> bytes:
    """Return the content of a regular file of at most `limit` bytes.

    Raises:
        FileNotFoundError: it does not exist. ValueError: a pipe, a device, too large, or unreadable.
    """

    def require_regular(mode: int) -> None:
        if not stat.S_ISREG(mode):
            raise ValueError("is no regular file but a folder, a pipe, a socket or a device")

    try:
        require_regular(path.stat().st_mode)
        # The file may be replaced after the check; without O_NONBLOCK, opening a pipe would block.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as stream:
            require_regular(os.fstat(stream.fileno()).st_mode)
            data = stream.read(limit + 1)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}") from None
    if len(data) > limit:
        raise ValueError(f"is larger than {limit / 1e6:g} MB, the most that is read of such a file")
    return data


class _CardLoader(yaml.SafeLoader):
    """Safe loader that refuses a key given twice, and aliases, by which a small card could stand for a huge one."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Return the next node, which must not be an alias."""
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            raise yaml.MarkedYAMLError(
                problem=f"alias *{event.anchor} is not read in a card; write the value out",
                problem_mark=event.start_mark,
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping whose keys all differ."""
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.MarkedYAMLError(
                        problem=f"key {show(key.value)} is given twice", problem_mark=key.start_mark
                    )
                seen.add(key.value)
        return dict(super().construct_mapping(node, deep))


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
    value = card[key]
    if not isinstance(value, str) or not value.strip() or len(value) > MAX_NAME:
        raise ValueError(f"{key} of the card must be text of at most {MAX_NAME} characters, got {show(value)}")
    if any(unicodedata.category(character) in ("Cc", "Cf", "Cs", "Zl", "Zp") for character in value):
        raise ValueError(f"{key} of the card has characters that cannot be shown: {value!a}")
    return value


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


def show(value: Any) -> str:
    """Return a short text of a value from a card; lists and mappings are only named."""
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a mapping"
    return cut(repr(value))


def cut(text: str, limit: int = 200) -> str:
    """Return a text in one line that a terminal can show, its end left out where it is longer than the limit."""
    line = " ".join(text[: 2 * limit].split())
    line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
    return line if len(line) <= limit else f"{line[: limit - 4]} ..."
