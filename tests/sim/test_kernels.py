"""Functions compiled ahead of time: the same numbers as Numba's, never those of other sources."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra import numpy as arrays
from numba import typeof

from bike_sim import kernels

AS_A_NODE = """
import sys
sys.argv[0] = "/somewhere/bike_sim/ros/sim_node.py"
"""
RIDE = """
import hashlib, sys
import numpy as np
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
digest = hashlib.sha256()
for engine in ("pybullet", "whipple"):
    simulator = Simulator(SimulatorConfig(engine=engine, time_step=0.005))
    for seed in range(3):
        simulator.reset(ResetRequest(course="random", seed=seed))
        for step in range(60):
            snapshot = simulator.step(0.1 * np.sin(0.1 * step))
            digest.update(snapshot.state.tobytes() + snapshot.look.tobytes() + snapshot.preview_y.tobytes())
print(digest.hexdigest(), "numba" in sys.modules)
"""
UNKNOWN_KINDS = """
import numpy as np
from bike_sim.course import projection
from bike_sim.physics import kinematics
from bike_sim.vehicles.files import load_vehicle
assert isinstance(projection.window, kernels.Kernel)
assert projection.window(1, 2, 3) == projection.window(1.0, 2.0, 3.0) == 3.0
parameters = load_vehicle("whipple").parameters
backwards = np.ascontiguousarray(parameters[::-1])[::-1]  # no layout that the library knows
assert kinematics.pitch(0.1, 0.2, backwards) == kinematics.pitch(0.1, 0.2, parameters)
import numba
@numba.njit
def twice(p):
    return 2.0 * kinematics.pitch(0.1, 0.2, p)
assert twice(parameters) == 2.0 * kinematics.pitch(0.1, 0.2, parameters)
"""


def run(program: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | environment, capture_output=True, text=True, timeout=200
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.usefixtures("prepared_kernels")
def test_rides_are_the_same_bit_for_bit_and_need_no_numba() -> None:
    prepared, numbas = run(AS_A_NODE + RIDE).split(), run(RIDE).split()
    assert prepared[0] == numbas[0]
    assert (prepared[1], numbas[1]) == ("False", "True")
    assert run(AS_A_NODE + RIDE, BIKE_KERNELS="numba").split() == numbas


@pytest.mark.usefixtures("prepared_kernels")
def test_numba_takes_what_the_library_does_not_know() -> None:
    run(AS_A_NODE + "from bike_sim import kernels" + UNKNOWN_KINDS)


@pytest.mark.usefixtures("prepared_kernels")
def test_a_library_of_other_sources_is_not_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for path in (kernels.library_path(), kernels.contents_path()):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    assert kernels.load_library(tmp_path) is not None
    now = kernels.sources()
    changed = now | {"physics/kinematics.py": [now["physics/kinematics.py"][0] + 1, now["physics/kinematics.py"][1]]}
    monkeypatch.setattr(kernels, "sources", lambda: changed)
    assert kernels.load_library(tmp_path) is None


@pytest.mark.parametrize("damage", ["no library", "no list", "half a list", "another format", "no such function"])
@pytest.mark.usefixtures("prepared_kernels")
def test_a_damaged_library_is_not_used(damage: str, tmp_path: Path) -> None:
    contents = json.loads(kernels.contents_path().read_text())
    text = json.dumps(contents)
    if damage == "half a list":
        text = text[: len(text) // 2]
    elif damage == "another format":
        text = json.dumps({"sources": contents["sources"]})
    elif damage == "no such function":
        contents["functions"][0][2] = "missing"
        text = json.dumps(contents)
    if damage != "no library":
        kernels.library_path(tmp_path).write_bytes(kernels.library_path().read_bytes())
    if damage != "no list":
        kernels.contents_path(tmp_path).write_text(text)
    assert kernels.load_library(tmp_path) is None


VALUES: some.SearchStrategy[Any] = some.recursive(
    some.one_of(
        some.floats(),
        some.booleans(),
        some.integers(-(2**62), 2**62),
        some.builds(np.float64, some.floats()),
        some.tuples(
            arrays.arrays(
                some.sampled_from([np.float64, np.float32, np.int64, np.int32, np.bool_]),
                arrays.array_shapes(max_dims=2, max_side=4),
            ),
            some.sampled_from(["as it is", "read-only", "backwards"]),
        ).map(lambda drawn: made_so(*drawn)),
    ),
    lambda inner: some.lists(inner, max_size=3).map(tuple),
    max_leaves=6,
)


def made_so(array: np.ndarray, how: str) -> np.ndarray:
    if how == "backwards":
        return array[::-1]
    array.flags.writeable = how == "as it is"
    return array


@given(VALUES, VALUES)
def test_kinds_tell_the_types_that_numba_tells(one: Any, other: Any) -> None:
    types = typeof(one), typeof(other)
    kinds = [kernels.kind_of_type(type_) for type_ in types]
    for value, kind in zip((one, other), kinds, strict=True):
        assert kind is None or kind == kernels.kind_of(value)
        assert kind is None or kernels.from_json(json.loads(json.dumps(kernels.to_json(kind)))) == kind
    if None not in kinds:
        assert (kinds[0] == kinds[1]) == (types[0] == types[1])


@pytest.mark.parametrize("value", [np.zeros(1, dtype=[("x", "f8")]), np.zeros(1, dtype=[("x", "f8")])[0], "text"])
def test_what_kinds_do_not_tell_is_not_prepared(value: Any) -> None:
    assert kernels.kind_of_type(typeof(value)) is None
