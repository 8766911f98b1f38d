"""Parameters of the simulator node: names, meanings and consistent combinations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from bike_sim.physics.engines import ENGINE_KINDS
from bike_sim.ros.node_tools import ParameterSpec
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances, load_disturbances
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.vehicles.files import load_vehicle

LOCKSTEP: Final = "lockstep"
FREE: Final = "free"
NEVER, FALL, END = "never", "fall", "end"

LONGEST_STEP: Final = 3600.0
"""Longest wall-clock time that free mode may take for a control period, s."""

_CONFIG = SimulatorConfig()
_PREVIEW = Preview()

SPECS: Final = (
    ParameterSpec("vehicle", _CONFIG.vehicle, "Shipped vehicle, or path of a YAML file.", fixed=True),
    ParameterSpec("engine", _CONFIG.engine, "Physics engine.", fixed=True, choices=ENGINE_KINDS),
    ParameterSpec("time_step", _CONFIG.time_step, "Integration step, s.", fixed=True),
    ParameterSpec("control_period", 0.0, "Time between two commands, s; 0 takes the vehicle's own.", fixed=True),
    ParameterSpec("history", _CONFIG.history, "Roll and steer angles kept in the lean history.", fixed=True),
    ParameterSpec(
        "mode",
        LOCKSTEP,
        "lockstep: one control period for each command that answers the last state. free: time runs by itself.",
        fixed=True,
        choices=(LOCKSTEP, FREE),
    ),
    ParameterSpec(
        "course", "benchmark", "Shipped course, path of a YAML or CSV file, or random. From the next episode."
    ),
    ParameterSpec(
        "speed",
        0.0,
        "Forward speed at the start of an episode, m/s; 0 takes the kind's own: 4 for a bicycle, at most 35 for a "
        "superbike. From the next episode.",
    ),
    ParameterSpec(
        "line", 1.0, "Circuit: line that is followed, 0 the median, 1 the ideal line. From the next episode."
    ),
    ParameterSpec(
        "progress", 0.0, "Circuit: where it begins, m along the centre line, below its length. From the next episode."
    ),
    ParameterSpec(
        "perturb", False, "Whether episodes start off the course, leaning and turning a little. From the next."
    ),
    ParameterSpec("seed", 0, "Seed of the first episode, counted up for each one the node begins; negative: drawn."),
    ParameterSpec(
        "preview_by_time", _PREVIEW.by_time, "Preview points by time, else by distance. From the next episode."
    ),
    ParameterSpec("preview_interval", _PREVIEW.interval, "Their interval, s or m. From the next episode."),
    ParameterSpec("preview_count", _PREVIEW.count, "Their number, the nearest included. From the next episode."),
    ParameterSpec(
        "real_time_factor",
        1.0,
        "Free mode: simulated over wall-clock time, at least a control period an hour; 0: a step for each command.",
    ),
    ParameterSpec(
        "command_timeout_s",
        0.5,
        "Free mode: simulated time without a command after which steering and throttle go to 0, s; 0: never.",
    ),
    ParameterSpec(
        "auto_reset",
        NEVER,
        "When a new episode begins by itself: never, after a fall, or at any end (fall, off course, course ridden).",
        choices=(NEVER, FALL, END),
    ),
    ParameterSpec(
        "disturbances",
        "",
        "Bicycles: shipped disturbances or a YAML file; wind, pushes, drive and wrong parameters act here.",
        fixed=True,
    ),
    ParameterSpec("publish_markers", True, "Publish markers for RViz and Foxglove where someone listens.", fixed=True),
)


@dataclass(frozen=True)
class NodeSettings:
    """Checked parameters of the simulator node.

    Attributes:
        simulator: what stays the same over all episodes.
        episode: request of the node's own episodes, without the speed.
        speed: forward speed at their start, m/s; 0 for the vehicle's own.
        seed: seed of the first of them, or negative.
        mode: LOCKSTEP or FREE.
        real_time_factor: simulated over wall-clock time in free mode; 0 for a step a command.
        command_timeout: s of simulated time, 0 for never.
        auto_reset: NEVER, FALL or END.
        publish_markers: whether markers are published.
        disturbances: of what is ridden, or None.
    """

    simulator: SimulatorConfig
    episode: ResetRequest
    speed: float
    seed: int
    mode: str
    real_time_factor: float
    command_timeout: float
    auto_reset: str
    publish_markers: bool
    disturbances: Disturbances | None

    @classmethod
    def from_parameters(cls, values: Mapping[str, Any]) -> NodeSettings:
        """Check parameters, one by one and together.

        Raises:
            ValueError: a value that is wrong. FileNotFoundError: an unknown vehicle, or no such disturbances.
        """
        for name in ("real_time_factor", "command_timeout_s", "control_period", "speed"):
            if not math.isfinite(values[name]) or values[name] < 0.0:
                raise ValueError(f"parameter {name} must be finite and not negative, got {values[name]!r}")
        simulator = SimulatorConfig(
            vehicle=values["vehicle"],
            engine=values["engine"],
            time_step=values["time_step"],
            control_period=values["control_period"] or load_vehicle(values["vehicle"]).control_period,
            history=values["history"],
        )
        slowest = simulator.control_period / LONGEST_STEP
        if 0.0 < values["real_time_factor"] < slowest:
            raise ValueError(
                f"parameter real_time_factor must be 0 or at least {slowest:.3g}, a control period an hour, "
                f"got {values['real_time_factor']!r}"
            )
        episode = ResetRequest(
            seed=max(values["seed"], 0),
            course=values["course"],
            speed_range=(values["speed"],) * 2 if values["speed"] else ResetRequest().speed_range,
            perturb=values["perturb"],
            preview=Preview(values["preview_by_time"], values["preview_interval"], values["preview_count"]),
            line=values["line"],
            progress=values["progress"],
        )
        return cls(
            simulator=simulator,
            episode=episode,
            speed=values["speed"],
            seed=values["seed"],
            mode=values["mode"],
            real_time_factor=values["real_time_factor"],
            command_timeout=values["command_timeout_s"],
            auto_reset=values["auto_reset"],
            publish_markers=values["publish_markers"],
            disturbances=load_disturbances(values["disturbances"]) if values["disturbances"] else None,
        )

    def request(self, simulator: Simulator) -> ResetRequest:
        """Return the request of the node's own episodes; also fills in what a reset leaves open.

        Raises:
            ValueError: an episode that cannot begin. FileNotFoundError: an unknown course.
        """
        request = self.episode if self.speed else simulator.at_own_speed(self.episode)
        simulator.check(request)
        return request
