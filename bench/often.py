"""The simulator node, with diagnostics ten times a second instead of once: for measurements in short windows.

python -m bench.often --ros-args -p mode:=lockstep
"""

from __future__ import annotations

from bike_sim.ros import sim_node

if __name__ == "__main__":
    sim_node.REPORT_PERIOD = 0.1  # type: ignore[misc]
    sim_node.HOUSEKEEPING_PERIOD = 0.05  # type: ignore[misc]
    sim_node.main()
