"""Reading the text files that users write: bounded in size, depth and time, with one clear error for what is wrong.

A file may come from anywhere. Nothing here waits for a pipe, fills the memory, or lets a file write control characters
into a terminal or a picture. Courses, vehicles and message definitions are read through it.
"""

from __future__ import annotations

import difflib
import os
import stat
import unicodedata
from collections.abc import Iterable
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import yaml

MAX_YAML_SIZE: Final = 250_000
"""Largest YAML file, bytes: some 6,000 elements of a course. The slowest content of that size takes some seconds."""

MAX_NAME: Final = 200
"""Longest name of a course, section, corner or vehicle, characters."""

MAX_SHOWN: Final = 200
"""Longest part of a file or name that a message repeats, characters."""

MAX_MESSAGE: Final = 800
"""Longest message about a file, characters."""

MAX_DEPTH: Final = 20
"""Deepest nesting of a YAML document."""

MAX_NODES: Final = 100_000
"""Most values of a YAML document, with every alias counted as what it stands for."""

KEPT: Final = 64
"""YAML documents that are kept: reading a vehicle takes a tenth of a second, and batches read it for each row."""

_UNSHOWN: Final = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
# Unicode categories that steer a terminal or a page instead of showing something: control and format characters
# (direction of writing among them), surrogates, separators of lines and paragraphs.


class DocumentError(ValueError):
    """A file cannot be read, or is not what it should be. The message begins with what is wrong, without the name."""


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the content of a regular file.

    Args:
        path: the file.
        limit: largest size, bytes.

    Raises:
        FileNotFoundError: there is none.
        DocumentError: it is a pipe, socket or device, larger than the limit, or cannot be read.
    """
    try:
        _require_regular(path.stat().st_mode)
        # What the name stands for may change after the look at it; without O_NONBLOCK a pipe would hold us here.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as stream:
            _require_regular(os.fstat(stream.fileno()).st_mode)
            data = stream.read(limit + 1)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise DocumentError(f"cannot be read: {error.strerror}") from None
    except ValueError as error:
        if isinstance(error, DocumentError):
            raise
        raise DocumentError(f"cannot be read: {error}") from None  # a name with a null byte
    if len(data) > limit:
        raise DocumentError(f"is larger than {_size(limit)}, the most that is read of such a file")
    return data


def read_text(path: Path, limit: int) -> str:
    """Return the text of a regular file in UTF-8, without a byte order mark.

    Args:
        path: the file.
        limit: largest size, bytes.

    Raises:
        FileNotFoundError: there is none.
        DocumentError: it is no regular file, too large, not UTF-8, or empty.
    """
    return decode(read_bytes(path, limit))


def decode(data: bytes) -> str:
    """Return bytes as text; see `read_text`."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        wrong = error.object[error.start]
        raise DocumentError(f"is not a UTF-8 text file (byte {error.start} is {wrong:#04x})") from None
    if "\0" in text:
        raise DocumentError(f"is a binary file (byte {data.index(0)} is 0x00)")
    if not text.strip():
        raise DocumentError("is empty")
    return text


def parse_yaml(text: str, as_text: bool = False) -> Any:
    """Return a YAML document; the same text again takes a copy of what it held before.

    Args:
        text: the document; at most MAX_YAML_SIZE characters.
        as_text: leave every value a string, so that the reader decides what is a number. Otherwise plain YAML types.

    Raises:
        DocumentError: it is no YAML, gives a key twice, or is nested or repeated beyond all use; in one line, with the
            row.
    """
    return deepcopy(_parsed(text, as_text))


@lru_cache(maxsize=KEPT)
def _parsed(text: str, as_text: bool) -> Any:
    if len(text) > MAX_YAML_SIZE:
        raise DocumentError(f"is larger than {_size(MAX_YAML_SIZE)}, the most that is read of a YAML file")
    try:
        return yaml.load(text, Loader=_TextLoader if as_text else _PlainLoader)
    except _Excess as error:
        raise DocumentError(str(error)) from None
    except yaml.MarkedYAMLError as error:
        where = f"row {error.problem_mark.line + 1}: " if error.problem_mark else ""
        what = " ".join(part for part in (error.problem, error.context and f"({error.context})") if part)
        raise DocumentError(f"is not valid YAML: {where}{shorten(what)}") from None
    except (yaml.YAMLError, ValueError) as error:  # a date or a number that cannot be is a ValueError
        raise DocumentError(f"is not valid YAML: {shorten(str(error))}") from None
    except RecursionError:
        raise DocumentError("is nested too deeply") from None


class _Excess(Exception):
    """A document that is valid YAML and still not read."""


class _Bounded(yaml.composer.Composer, yaml.constructor.BaseConstructor):
    """Makes a YAML loader refuse a key given twice, deep nesting, and aliases that multiply or contain themselves."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)  # type: ignore[call-arg]
        self._open = 0
        self._measures: dict[int, tuple[int, int]] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Return the next node, measured with all that it stands for.

        Raises:
            _Excess: it is nested too deeply, too large, or contains itself.
        """
        row = self.peek_event().start_mark.line + 1  # type: ignore[attr-defined]
        if self.check_event(yaml.AliasEvent):  # type: ignore[attr-defined]
            node = super().compose_node(parent, index)
            if id(node) not in self._measures:
                raise _Excess(f"holds a value that contains itself, by an alias at row {row}")
            return node
        self._open += 1
        if self._open > MAX_DEPTH:
            raise _Excess(f"is nested too deeply: more than {MAX_DEPTH} levels at row {row}")
        node = super().compose_node(parent, index)
        self._open -= 1
        children: list[yaml.Node] = []
        if isinstance(node, yaml.SequenceNode):
            children = node.value
        elif isinstance(node, yaml.MappingNode):
            children = [part for pair in node.value for part in pair]
        nodes = 1 + sum(self._measures[id(child)][0] for child in children)
        depth = 1 + max((self._measures[id(child)][1] for child in children), default=0)
        if depth > MAX_DEPTH:
            raise _Excess(f"is nested too deeply: more than {MAX_DEPTH} levels by its aliases at row {row}")
        if nodes > MAX_NODES:
            raise _Excess(f"holds more than {MAX_NODES} values at row {row}, aliases counted as what they stand for")
        self._measures[id(node)] = (nodes, depth)
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping.

        Raises:
            yaml.MarkedYAMLError: a key stands there twice; YAML would silently drop the first.
        """
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.MarkedYAMLError(
                        problem=f"key {show(key.value)} is given twice", problem_mark=key.start_mark
                    )
                seen.add(key.value)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping


class _TextLoader(_Bounded, yaml.BaseLoader):
    """Loader that leaves every value a string."""


class _PlainLoader(_Bounded, yaml.SafeLoader):
    """Loader of plain types."""


def check_name(value: Any, what: str) -> str:
    """Return a name as it is.

    Args:
        value: of a file or a caller.
        what: what it is the name of, for the message.

    Raises:
        DocumentError: it is not text, blank, longer than MAX_NAME, or holds characters that cannot be shown.
    """
    if not isinstance(value, str) or not value.strip():
        raise DocumentError(f"{what} must be text, got {show(value)}")
    if len(value) > MAX_NAME:
        raise DocumentError(f"{what} has {len(value)} characters, at most {MAX_NAME} are possible: {show(value)}")
    for place, character in enumerate(value, start=1):
        if unicodedata.category(character) in _UNSHOWN:
            raise DocumentError(
                f"{what} {show(value)} has the character U+{ord(character):04X} at place {place}, which cannot be shown"
            )
    return value


def check_text(value: Any, what: str, limit: int = 4000) -> str:
    """Return a text for people, such as a description; line ends and tabs may be in it.

    Raises:
        DocumentError: it is not text, longer than the limit, or holds control characters.
    """
    if not isinstance(value, str) or not value.strip():
        raise DocumentError(f"{what} must be text, got {show(value)}")
    if len(value) > limit:
        raise DocumentError(f"{what} has {len(value)} characters, at most {limit} are possible: {show(value)}")
    if escape(value, keep="\n\t") != value:
        raise DocumentError(f"{what} {show(value)} has characters that cannot be shown")
    return value


def escape(text: str, keep: str = "") -> str:
    """Return a text with all characters that cannot be shown written as in Python source."""
    return "".join(
        c.encode("unicode_escape").decode("ascii") if c not in keep and unicodedata.category(c) in _UNSHOWN else c
        for c in text
    )


def shorten(text: str, limit: int = MAX_SHOWN) -> str:
    """Return a text in one line without control characters, its middle left out where it is longer than the limit."""
    line = escape(" ".join(text[: 4 * limit].split()) if len(text) <= 4 * limit else _middle_out(text, 4 * limit))
    return line if len(line) <= limit else _middle_out(line, limit)


def _middle_out(text: str, limit: int) -> str:
    head = (limit - 5) // 2
    return f"{text[:head]} ... {text[len(text) - (limit - 5 - head) :]}"


def alternatives(name: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown name: the known one that may be meant, and all that there are."""
    names = list(known)
    near = difflib.get_close_matches(name[:MAX_NAME], names, 1)
    return f"{f'did you mean {near[0]}? There' if near else 'there'} are {', '.join(names)}"


def show(value: Any, limit: int = 60) -> str:
    """Return a short text of a value from a file; lists and mappings may be huge, so they are only named."""
    if isinstance(value, str):
        return repr(value if len(value) <= limit else value[: limit - 3] + "...")
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 10**limit:
        return "a whole number of too many digits"
    return shorten(repr(value), limit)


def _require_regular(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise DocumentError("cannot be read: Is a directory")
    if not stat.S_ISREG(mode):
        raise DocumentError("is no file but a pipe, a socket or a device, which might never end")


def _size(limit: int) -> str:
    return f"{limit / 1e6:g} MB" if limit >= 1_000_000 else f"{limit / 1e3:g} kB"
