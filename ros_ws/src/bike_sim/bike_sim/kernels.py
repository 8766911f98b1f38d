"""Compiled functions: by Numba, or from a library that the set-up has compiled ahead of time.

Before its first cached function runs, Numba loads itself, LLVM, SciPy's BLAS and the tables of all that it can compile:
more than half of the processor time of a simulator node's start (``bike bench start``). A node that is started again in
the middle of a ride has no use for any of it. So `tools/prepare_kernels.py` has Numba compile, once, the functions that
Python calls in a ride, into an extension module that stands alone. A node takes them from there; every other process,
and a node whose sources have changed since, compiles with Numba as ever. The machine code comes from the same compiler
under the same rules of arithmetic, so rides are the same bit for bit.

Modules whose functions a node rides with decorate them with the `njit` of this module in place of Numba's.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from collections.abc import Callable, Mapping
from functools import cached_property
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader, ModuleSpec
from pathlib import Path
from typing import Any, Final

import numpy as np

LIBRARY: Final = "bike_kernels"
"""Name of the extension module."""
FOLDER: Final = Path(__file__).with_name("__pycache__")
"""Where it lies: with all else that is made from the sources and may be deleted."""
SOURCES: Final = ("course", "physics", "sim", "vehicles")
"""Rooms of the simulator whose sources end up in it, called functions and constants included."""
NODES: Final = ("sim_node", "drive")
"""Programs that take compiled functions from it, by the name of their file, whoever starts them."""
CHOICE_VARIABLE: Final = "BIKE_KERNELS"
"""With the value ``numba``, nodes take them from Numba as well."""

Kind = Any
"""What a compiled function was compiled for: a scalar type, or dtype, dimensions and layout of an array, or a tuple."""

_SCALARS: Final[Mapping[type, str]] = {float: "float64", np.float64: "float64", int: "int64", bool: "boolean"}
_C_CONTIGUOUS, _ALIGNED, _WRITEABLE = 0x1, 0x100, 0x400  # of NumPy's ndarray.flags.num
_LAYOUT: Final = _C_CONTIGUOUS | _ALIGNED | _WRITEABLE


def kind_of(value: Any) -> Kind:
    """Return what a function must be compiled for to take a value as argument."""
    kind = type(value)
    if kind is np.ndarray:
        return value.dtype, value.ndim, value.flags.num & _LAYOUT
    if kind is tuple:
        return tuple([kind_of(entry) for entry in value])
    return _SCALARS.get(kind, kind)


def kind_of_type(type_: Any) -> Kind | None:
    """Return the same for a type of Numba, or None where `kind_of` would not tell it from others, as for records."""
    from numba import types  # type: ignore[attr-defined]
    from numba.np.numpy_support import as_dtype

    if isinstance(type_, types.UniTuple | types.Tuple):
        kinds = tuple(kind_of_type(entry) for entry in type_)
        return None if None in kinds else kinds
    if isinstance(type_, types.Array):
        if type_.layout not in "CA" or not isinstance(type_.dtype, types.Float | types.Integer | types.Boolean):
            return None
        layout = (type_.layout == "C") * _C_CONTIGUOUS | type_.aligned * _ALIGNED | bool(type_.mutable) * _WRITEABLE
        return as_dtype(type_.dtype), type_.ndim, layout
    return {types.float64: "float64", types.int64: "int64", types.boolean: "boolean"}.get(type_)


class Kernel:
    """A function of the library, which Numba compiles for arguments that the library does not know.

    Attributes:
        py_func: the function as it is written.
    """

    def __init__(self, function: Callable[..., Any], options: Mapping[str, Any], prepared: dict[Kind, Any]) -> None:
        """Take a function's place.

        Args:
            function: as it is written.
            options: of Numba's decorator.
            prepared: what the library has of it, by the kinds of its arguments.
        """
        self.py_func = function
        self._options = options
        self._prepared = prepared
        self.__doc__ = function.__doc__

    def __call__(self, *args: Any) -> Any:
        """Call the function that is compiled for these arguments."""
        prepared = self._prepared.get(tuple([kind_of(value) for value in args]))
        return self.dispatcher(*args) if prepared is None else prepared(*args)

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's own compiled function."""
        import numba

        return numba.njit(**self._options)(self.py_func)

    @property
    def _numba_type_(self) -> Any:
        """What Numba takes this for where a function that it compiles calls it."""
        return self.dispatcher._numba_type_


made: Final[list[Any]] = []
"""Numba's compiled functions of this process, for the program that makes the library."""


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function for calls from Python and from other compiled functions; the options are Numba's."""
    if _library is not None:
        library = _library
        return lambda function: Kernel(function, options, library.get(full_name(function), {}))
    import numba

    decorate = numba.njit(**options)

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = decorate(function)
        made.append(dispatcher)
        return dispatcher

    return compiled


def entry_of(function: Any, args: tuple[Any, ...]) -> Any:
    """Return the compiled function itself for arguments of these types, compiled if it was not yet.

    Numba's own call looks at the type of every argument first, which for records costs as much as a good part of a
    control step. Who calls with the same types every time may do without; what is called is the same machine code.
    Arguments of other types, other layouts of arrays included, must never reach it.

    Args:
        function: decorated with `njit`; one that is not compiled is returned as it is.
        args: such as it will be called with.
    """
    if not hasattr(function, "get_overload"):
        return function
    import numba

    types = tuple(numba.typeof(value) for value in args)
    function.compile(types)
    return function.get_overload(types)


def full_name(function: Callable[..., Any]) -> str:
    """Return a name that no other function has."""
    return f"{function.__module__}.{function.__qualname__}"


# -------------------------------------------------------------------------------------------------------- the library


def library_path(folder: Path = FOLDER) -> Path:
    """Return the path of the extension module for this Python."""
    return folder / (LIBRARY + EXTENSION_SUFFIXES[0])


def contents_path(folder: Path = FOLDER) -> Path:
    """Return the path of the list of what is in it."""
    return folder / f"{LIBRARY}.json"


def sources() -> dict[str, list[int]]:
    """Return time of change (ns) and size (bytes) of all sources that the library depends on."""
    root = Path(__file__).parent
    paths = [Path(__file__), *(path for room in SOURCES for path in sorted((root / room).rglob("*.py")))]
    return {str(path.relative_to(root)): [path.stat().st_mtime_ns, path.stat().st_size] for path in paths}


def load_library(folder: Path = FOLDER) -> dict[str, dict[Kind, Callable[..., Any]]] | None:
    """Return the functions of the library by name and kinds of arguments; None where it is missing or out of date."""
    functions: dict[str, dict[Kind, Callable[..., Any]]] = {}
    try:
        contents = json.loads(contents_path(folder).read_text())
        if contents["sources"] != sources():
            return None
        loader = ExtensionFileLoader(LIBRARY, str(library_path(folder)))
        module = importlib.util.module_from_spec(ModuleSpec(LIBRARY, loader, origin=loader.path))
        loader.exec_module(module)
        for name, kinds, export in contents["functions"]:
            functions.setdefault(name, {})[from_json(kinds)] = getattr(module, export)
    except (OSError, ImportError, AttributeError, ValueError, KeyError):  # incomplete, or of another Python or NumPy
        return None
    return functions


def to_json(kind: Kind) -> Any:
    """Return a kind as JSON: a text for a scalar, an object for an array, a list for a tuple."""
    if isinstance(kind, str):
        return kind
    if len(kind) == 3 and isinstance(kind[0], np.dtype):
        return {"dtype": kind[0].str, "dimensions": kind[1], "layout": kind[2]}
    return [to_json(entry) for entry in kind]


def from_json(kind: Any) -> Kind:
    """Return the kind of what `to_json` made."""
    if isinstance(kind, str):
        return kind
    if isinstance(kind, dict):
        return np.dtype(kind["dtype"]), kind["dimensions"], kind["layout"]
    return tuple(from_json(entry) for entry in kind)


def _wants_library() -> bool:
    """Return whether this process is a node that may have one."""
    return Path(sys.argv[0]).stem in NODES and os.environ.get(CHOICE_VARIABLE) != "numba"


_library: Final = load_library() if _wants_library() else None
