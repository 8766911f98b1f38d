#!/usr/bin/env python3
"""Compiles the functions that a riding node calls into an extension module, so that it starts without Numba.

The rides that `compile_kernels.py` knows are begun again, which tells the functions that Python calls and the types it
calls them with; Numba's ahead-of-time compiler does the rest. `bike_sim.kernels` has the other side.

    .venv/bin/python tools/prepare_kernels.py
"""

from __future__ import annotations

import json
import os
import tempfile
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import compile_kernels

from bike_sim import kernels

RIDES = ("bicycle, compiled engine", "bicycle, PyBullet", "bicycle with the LQR")
"""Rides of `compile_kernels` whose functions are prepared. Those of superbikes take records, whose type a call does not
tell cheaply, so they are left to Numba."""


def prepare(dispatchers: Iterable[Any], folder: Path) -> list[str]:
    """Make the library of what has been called, and put it in the place of an older one.

    Args:
        dispatchers: functions compiled by Numba.
        folder: where the library lies.

    Returns:
        The names of its functions.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Numba means to replace this compiler, and does not say by what
        from numba.pycc import CC
    sources = kernels.sources()
    # Portable code: the library may be used on another machine than this, as in a container image.
    compiler = CC(kernels.LIBRARY, source_module=kernels)
    functions: list[tuple[str, Any, str]] = []
    for dispatcher in dispatchers:
        name = kernels.full_name(dispatcher.py_func)
        for types, overload in dispatcher.overloads.items():
            kinds = [kernels.kind_of_type(type_) for type_ in types]
            if None not in kinds:
                export = f"{name.replace('.', '__')}__{len(functions)}"
                compiler.export(export, overload.signature)(dispatcher.py_func)
                functions.append((name, kernels.to_json(tuple(kinds)), export))
    folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as made:
        compiler.output_dir = made
        compiler.compile()
        contents = Path(made) / "contents"
        contents.write_text(json.dumps({"sources": sources, "functions": functions}))
        # A node that starts at this moment finds a library that is not in the list of what is in it, and takes Numba.
        kernels.contents_path(folder).unlink(missing_ok=True)
        os.replace(Path(made) / compiler.output_file, kernels.library_path(folder))
        os.replace(contents, kernels.contents_path(folder))
    return [name for name, _, _ in functions]


def main() -> None:
    """Ride, and make the library."""
    for ride in RIDES:
        compile_kernels.KERNELS[ride]()
    print("prepared:", *prepare(kernels.made, kernels.FOLDER))


if __name__ == "__main__":
    main()
