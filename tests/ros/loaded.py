"""Loads and compiles what nodes need, where nobody waits: on a busy machine it takes minutes if nothing is cached.

`forked` forks nodes from a process that has imported this.
"""

import gc
import tempfile
from pathlib import Path

import bike_sim.ros.race_node
import bike_sim.ros.record  # noqa: F401
from bike_sim.ros.sim_node import SPECS, NodeSettings
from bike_sim.sim.simulator import Simulator
from tests.circuits import write_oval

with tempfile.TemporaryDirectory() as _folder:
    _circuit = write_oval(Path(_folder))
    for _changes in ({}, {"engine": "whipple"}, {"vehicle": "panigale_v4r", "course": str(_circuit)}):
        _settings = NodeSettings.from_parameters({spec.name: spec.default for spec in SPECS} | _changes)
        _simulator = Simulator(_settings.simulator)
        _simulator.reset(_settings.request(_simulator))
        _simulator.step(0.0)
        _simulator.close()
gc.freeze()
