"""Reading what people write: text files and YAML documents, with one clear error for what is wrong."""

from __future__ import annotations

import math
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from bike_sim.course.csv_line import CourseFileError
from bike_sim.unique_keys import UniqueKeys

MAX_LENGTH = 100e3
"""Longest course, m. A longer one is a mistake of units, and would fill the memory with samples."""

MAX_FILE_SIZE = 50_000_000
"""Largest course file, bytes."""


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        FileNotFoundError: there is none.
        CourseFileError: it cannot be read as text.
    """
    try:
        status = path.stat()
        if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
            raise CourseFileError("is no file but a pipe or a device, which might never end")
        if status.st_size > MAX_FILE_SIZE:
            raise CourseFileError(f"is larger than {MAX_FILE_SIZE // 1_000_000} MB, which no course is")
        data = path.read_bytes()
    except FileNotFoundError:
        raise FileNotFoundError(f"there is no course file {path}") from None
    except OSError as error:
        raise CourseFileError(f"cannot be read: {error.strerror}") from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CourseFileError(f"is not a UTF-8 text file (byte {error.start} is {data[error.start]:#04x})") from None
    if "\0" in text:
        raise CourseFileError("is a binary file")
    if not text.strip():
        raise CourseFileError("is empty")
    return text


def parse_yaml(text: str, keys: tuple[str, ...]) -> Mapping[str, Any]:
    """Return a YAML document with all values as strings; ``keys`` are named when it is no mapping at all."""
    # The base loader leaves every value a string: what a number or a truth value is, is decided here, where a mistake
    # can be named, and '1e3' is a number as everywhere else.
    try:
        document = yaml.load(text, Loader=_UniqueKeyLoader)
    except yaml.MarkedYAMLError as error:
        where = f"row {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise CourseFileError(f"{where}{error.problem or error.context}") from None
    except yaml.YAMLError as error:
        raise CourseFileError(f"is not YAML: {str(error).splitlines()[0]}") from None
    except RecursionError:
        raise CourseFileError("is nested too deeply") from None
    if not isinstance(document, dict):
        raise CourseFileError(f"must be a mapping with the keys {', '.join(keys)}")
    return document


class _UniqueKeyLoader(UniqueKeys, yaml.BaseLoader):
    """Base loader that refuses a key given twice."""


def values_of(value: Any, where: str, keys: tuple[str, ...]) -> list[Any]:
    """Return the values of a mapping that has exactly these keys."""
    if not isinstance(value, dict):
        raise CourseFileError(f"{where} must be a mapping with {' and '.join(keys)}, got {show(value)}")
    check_keys(f"{where}: ", value, keys)
    for key in keys:
        if key not in value:
            raise CourseFileError(f"{where}: {key} is missing")
    return [value[key] for key in keys]


def check_keys(where: str, found: Mapping[Any, Any], known: tuple[str, ...]) -> None:
    """Refuse keys that are not known."""
    for key in found:
        if key not in known:
            raise CourseFileError(f"{where}unknown key {show(key)}; known are {', '.join(known)}")


def text_of(found: Mapping[str, Any], key: str, default: str, where: str = "") -> str:
    """Return the text of a key, or the default where the key is not there."""
    value = found.get(key, default)
    if not isinstance(value, str) or (key in found and not value.strip()):
        raise CourseFileError(f"{where}{key} must be text, got {show(value)}")
    return value


def truth_of(value: Any, name: str) -> bool:
    """Return a truth value, written true or false."""
    if value not in ("true", "false"):
        raise CourseFileError(f"{name} must be true or false, got {show(value)}")
    return bool(value == "true")


def number_of(value: Any, name: str) -> float:
    """Return a finite number."""
    try:
        number = float(value) if isinstance(value, str) else math.nan
    except ValueError:
        raise CourseFileError(f"{name} is {show(value)}, a number is needed") from None
    if not math.isfinite(number):
        raise CourseFileError(f"{name} is {show(value)}, a finite number is needed")
    return number


def length_of(value: Any, name: str) -> float:
    """Return a finite number that can be a length of a course, m."""
    number = number_of(value, name)
    if abs(number) > MAX_LENGTH:
        raise CourseFileError(f"{name} is {show(value)}, more than {MAX_LENGTH:g} m; metres?")
    return number


def show(value: Any) -> str:
    """Return a short text of a value from a file; lists and mappings may be huge, so they are only named."""
    if isinstance(value, str):
        return repr(value if len(value) <= 60 else value[:57] + "...")
    return "a list" if isinstance(value, list) else "a mapping"
