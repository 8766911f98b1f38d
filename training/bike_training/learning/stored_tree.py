"""Trees of plain values and arrays as two files: JSON and safetensors. Reading them runs no code of theirs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

_ARRAY: Final = "$array"
"""Key of a table that stands for an array of the other file."""


def write_tree(tree: dict[str, Any], plain: Path, tensors: Path) -> None:
    """Write a tree of tables, lists, texts, numbers, truth values, None and NumPy arrays.

    Args:
        tree: what to write.
        plain: JSON file; it is written last, so where it is, both are whole.
        tensors: safetensors file.

    Raises:
        TypeError: a value of another kind.
    """
    arrays: dict[str, NDArray[Any]] = {}
    text = json.dumps(_without_arrays(tree, "", arrays))
    save_file(arrays, tensors)
    unfinished = plain.with_name(f"{plain.name}.part")
    unfinished.write_text(text, encoding="utf-8")
    unfinished.replace(plain)


def read_plain(plain: Path) -> dict[str, Any]:
    """Read the JSON file of a tree; its arrays are still missing.

    Raises:
        ValueError: no such tree.
    """
    tree = json.loads(plain.read_text(encoding="utf-8"))
    if not isinstance(tree, dict):
        raise ValueError(f"it holds a {type(tree).__name__} and not a table")
    return tree


def with_tensors(plain: dict[str, Any], tensors: Path) -> dict[str, Any]:
    """Return a tree with its arrays.

    Args:
        plain: what :func:`read_plain` returned.
        tensors: its safetensors file.

    Raises:
        SafetensorError: a damaged file. KeyError: an array is missing there.
    """
    found: dict[str, Any] = _with_arrays(plain, load_file(tensors))
    return found


def _without_arrays(node: Any, name: str, arrays: dict[str, NDArray[Any]]) -> Any:
    if isinstance(node, np.ndarray):
        arrays[name] = np.array(node, order="C")  # the format takes the bytes as they lie
        return {_ARRAY: name}
    if isinstance(node, dict):
        return {key: _without_arrays(value, f"{name}/{key}" if name else key, arrays) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_without_arrays(value, f"{name}/{index}", arrays) for index, value in enumerate(node)]
    return node.item() if isinstance(node, np.generic) else node


def _with_arrays(node: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    if isinstance(node, dict):
        if set(node) == {_ARRAY}:
            return arrays[node[_ARRAY]]
        return {key: _with_arrays(value, arrays) for key, value in node.items()}
    return [_with_arrays(value, arrays) for value in node] if isinstance(node, list) else node
