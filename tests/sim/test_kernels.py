"""Compiled functions are found in Numba's cache: a node that starts again compiles nothing."""

from __future__ import annotations

import subprocess
import sys

RIDE = """
import sys
from numba.core.dispatcher import Dispatcher
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
for config in (SimulatorConfig(engine="pybullet"), SimulatorConfig(engine="whipple"), superbike_config("r1")):
    simulator = Simulator(config)
    simulator.reset(ResetRequest(course="line"))
    simulator.step(0.1)
modules = [module for name, module in sys.modules.items() if name.startswith("bike_sim")]
functions = {id(value): value for module in modules for value in vars(module).values() if isinstance(value, Dispatcher)}
print(sum(sum(function.stats.cache_misses.values()) for function in functions.values()), len(functions))
"""


def test_a_second_start_compiles_nothing() -> None:
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", RIDE], capture_output=True, text=True, timeout=250)
        assert done.returncode == 0, done.stderr
        misses, functions = map(int, done.stdout.split())
        if misses == 0:
            break  # there had been a first start
    assert misses == 0
    assert functions > 10
