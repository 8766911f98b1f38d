"""Message definitions as a recording needs them: the text of a type with all nested types, and its hash.

They come from the ``.msg`` files of installed packages, in the order in which rosbag2 writes them
(rosbag2_cpp/message_definitions of Jazzy). Nothing here imports a message package.
"""

from __future__ import annotations

import json
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bike_sim.documents import DocumentError, read_text

MAX_DEFINITION_SIZE: Final = 1_000_000
"""Largest file of a definition, bytes; those of ROS 2 have at most some 100 kB."""

_PRIMITIVE: Final = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_FIELD_TYPE: Final = re.compile(r"^[ \t]*([A-Za-z][A-Za-z0-9_/]*)", re.MULTILINE)


@dataclass(frozen=True)
class MessageType:
    """A message type as a recording describes it.

    Attributes:
        name: Full name, ``package/msg/Type``.
        definition: Text in the ``ros2msg`` encoding: the type's own ``.msg``, then each nested type once.
        type_hash: REP-2011 hash (``RIHS01_...``), or empty where the package was not built.
    """

    name: str
    definition: str
    type_hash: str = ""


def ament_share(package: str) -> Path:
    """Find the share directory of an installed package through the ament index.

    Args:
        package: Name of a ROS package.

    Returns:
        Its share directory, from the first prefix in ``AMENT_PREFIX_PATH`` (or else this Python's prefix) that has it.

    Raises:
        FileNotFoundError: If no prefix has the package.
    """
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p] or [Path(sys.prefix)]
    for prefix in prefixes:
        share = prefix / "share" / package
        marker = prefix / "share" / "ament_index" / "resource_index" / "packages" / package
        if marker.exists() and share.is_dir():
            return share
    searched = ", ".join(str(p) for p in prefixes)
    raise FileNotFoundError(f"ROS package {package!r} is not installed under {searched}; is the workspace built?")


def message_type(name: str) -> MessageType:
    """Describe a message type from its installed ``.msg`` files.

    Args:
        name: Full name, ``package/msg/Type``.

    Returns:
        The type with its self-contained definition.

    Raises:
        ValueError: If `name` is not of the form ``package/msg/Type``.
        FileNotFoundError: If the package or the type does not exist.
    """
    _split(name)
    texts: dict[str, str] = {}
    _collect(name, texts)
    parts = [texts[name]]
    parts += [f"{'=' * 80}\nMSG: {_short(other)}\n{text}" for other, text in texts.items() if other != name]
    return MessageType(name, "\n".join(parts), _type_hash(name))


def _split(name: str) -> tuple[str, str]:
    package, separator, kind = name.partition("/msg/")
    if not separator or not package or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", kind):
        raise ValueError(f"message type {name!r} is not of the form package/msg/Type")
    return package, kind


def _short(name: str) -> str:
    return "/".join(_split(name))


def _collect(name: str, texts: dict[str, str]) -> None:
    """Add the text of `name` and of its nested types to `texts`, depth first and in sorted order as rosbag2 does."""
    package, kind = _split(name)
    path = ament_share(package) / "msg" / f"{kind}.msg"
    if not path.is_file():
        raise FileNotFoundError(f"package {package!r} has no message {kind!r} ({path} does not exist)")
    texts[name] = _read(path)
    for nested in sorted(_nested_types(texts[name], package)):
        if nested not in texts:
            _collect(nested, texts)


def _nested_types(text: str, package: str) -> set[str]:
    """Full names of the message types that the fields of a ``.msg`` text use."""
    names = set()
    for field_type in _FIELD_TYPE.findall(text):
        if _PRIMITIVE.fullmatch(field_type):
            continue
        owner, _, kind = field_type.rpartition("/")
        names.add(f"{owner.removesuffix('/msg') or package}/msg/{kind}")
    return names


def _type_hash(name: str) -> str:
    package, kind = _split(name)
    path = ament_share(package) / "msg" / f"{kind}.json"
    if not path.is_file():  # a package whose build made no hashes
        return ""
    text = _read(path)
    try:
        hashes = json.loads(text)["type_hashes"]
        return next((str(entry["hash_string"]) for entry in hashes if entry["type_name"] == name), "")
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ValueError(f"{path} does not list type hashes as a build of messages does; is it damaged?") from None


def _read(path: Path) -> str:
    """Return the text of a definition.

    Raises:
        ValueError: the file cannot be read, or is not text.
    """
    try:
        return read_text(path, MAX_DEFINITION_SIZE)
    except DocumentError as error:
        raise ValueError(f"message definition {path} {error}") from None
