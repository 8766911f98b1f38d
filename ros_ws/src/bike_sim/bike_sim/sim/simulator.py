"""One vehicle in one scene, in control steps. Node, training and evaluation all use this simulator."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.course import Course
from bike_sim.course.track import Track
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.beginning import Courses, begin, own_speed
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.disturbed_plant import make_disturbed_plant
from bike_sim.sim.events import fall_event, reset_event
from bike_sim.sim.plant import Plant
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.scene import PathScene
from bike_sim.sim.snapshot import DIVERGED, NO_FALL, Snapshot
from bike_sim.vehicles.bicycle import Vehicle

if TYPE_CHECKING:
    from bike_sim.sim.circuit_scene import CircuitScene

FloatArray = NDArray[np.float64]


class Simulator:
    """Rides one vehicle, bicycle or superbike, on paths and circuits.

    A simulator is deterministic: the same request and the same commands give the same snapshots, bit for bit.

    Attributes:
        config: vehicle, engine and steps.
        plant: the vehicle and its engine.
        request: of the present episode.
        scene: of the present episode, or None before the first.
        episode: number of the present episode.
    """

    def __init__(self, config: SimulatorConfig | None = None, disturbances: Disturbances | None = None) -> None:
        """Load the vehicle and start the engine.

        Args:
            config: vehicle, engine and steps.
            disturbances: of what is ridden; those of what the rider sees are not the simulator's.

        Raises:
            ValueError: an invalid parameter. FileNotFoundError: an unknown vehicle.
        """
        self.config = config or SimulatorConfig()
        self.plant: Plant = make_disturbed_plant(self.config, disturbances)
        self.request = ResetRequest()
        self.scene: PathScene | CircuitScene | None = None
        self.episode = 0
        self._courses = Courses()

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle's parameters."""
        return self.plant.vehicle

    @property
    def course(self) -> Course | None:
        """The followed line of the present episode, or None before the first."""
        return None if self.scene is None else self.scene.course

    @property
    def track(self) -> Track | None:
        """The circuit of the present episode, or None where there is none."""
        return None if self.scene is None else self.scene.track

    @property
    def preview(self) -> Preview:
        """The preview of the present episode."""
        return self.plant.preview or self.request.preview

    def share_courses(self, other: Simulator) -> None:
        """Take courses from where another simulator of the same vehicle takes them."""
        self._courses = other._courses

    def at_own_speed(self, request: ResetRequest) -> ResetRequest:
        """Return a request with the default start speed of this vehicle.

        Raises:
            ValueError: an invalid course or position. FileNotFoundError: an unknown course.
        """
        speed = own_speed(request, self.plant, self._courses)
        return replace(request, speed_range=(speed, speed))

    def check(self, request: ResetRequest) -> None:
        """Check that an episode can begin; the present one continues.

        Raises:
            ValueError: why it cannot. FileNotFoundError: an unknown course.
        """
        begin(request, self.plant, self._courses)

    def reset(self, request: ResetRequest) -> Snapshot:
        """Begin an episode.

        Raises:
            ValueError: a request that cannot be met; the current episode is unchanged.
            FileNotFoundError: an unknown course.
        """
        scene, state = begin(request, self.plant, self._courses)
        self.plant.reset(state, scene.ground)
        self.scene, self.request = scene, request
        self.episode += 1
        self._step = 0
        self._rolls: deque[float] = deque(maxlen=self.config.history)
        self._steers: deque[float] = deque(maxlen=self.config.history)
        self._last = self._look(0.0, 0.0, begins=True)
        return self._last

    def step(self, steering: float, throttle: float = 0.0) -> Snapshot:
        """Hold both commands for one control period.

        Physics that diverges ends the episode: the last finite snapshot is shown again, as a fall.

        Args:
            steering: in [-1, 1], positive to the left. Bicycle: 1 is the largest steering set point. Superbike: 1
                requests the virtual rider's largest lean.
            throttle: in [-1, 1]; above 0 part of the engine's torque, below 0 part of the brakes' force. A bicycle has
                no drive and ignores it.

        Raises:
            ValueError: a command that is not finite or out of range.
            RuntimeError: no episode was begun.
        """
        scene = self.scene
        if scene is None:
            raise RuntimeError("call reset before step")
        if not -1.0 <= steering <= 1.0 or not -1.0 <= throttle <= 1.0:
            raise ValueError(f"commands must lie in [-1, 1], got steering {steering!r} and throttle {throttle!r}")
        if not scene.stopped:
            self.plant.advance(steering, throttle, self.config.substeps, scene.ground)
        self._step += 1
        self._last = self._look(steering, throttle)
        return self._last

    def close(self) -> None:
        """Release the engine; a second call does nothing."""
        self.plant.close()

    def _look(self, steering: float, throttle: float, begins: bool = False) -> Snapshot:
        scene, plant = self.scene, self.plant
        assert scene is not None
        state, signals = plant.state(), plant.signals()
        # A sum of squares, which is finite where all values are; it costs a fraction of a plain sum.
        if not math.isfinite(state.dot(state) + signals.dot(signals)):
            return self._diverged()
        time = self._step * self.config.control_period
        view = scene.look(state, signals, time, plant.fall(state))
        if not math.isfinite(view.look.dot(view.look)):
            return self._diverged()
        events = view.events
        if begins:
            progress = view.look[lk.PROGRESS] if view.circuit is None else view.circuit.place[lk.CENTRE_PROGRESS]
            events = (reset_event(self.episode, scene.course, scene.track, float(progress)), *events)
        self._rolls.append(float(state[st.ROLL]))
        self._steers.append(float(state[st.STEER]))
        return Snapshot(
            episode=self.episode,
            step=self._step,
            time=time,
            state=state,
            look=view.look,
            steering=steering,
            throttle=throttle,
            steer_torque=plant.steer_torque(steering, state, signals),
            preview_x=view.preview_x,
            preview_y=view.preview_y,
            roll_history=tuple(self._rolls),
            steer_history=tuple(self._steers),
            fallen=view.fall != NO_FALL,
            off_course=view.off_course,
            finished=view.finished,
            fall=view.fall,
            signals=signals,
            circuit=view.circuit,
            events=events,
        )

    def _diverged(self) -> Snapshot:
        """Return the last finite snapshot as a fall at the present step."""
        last, time = self._last, self._step * self.config.control_period
        fall = () if last.fallen else (fall_event(time, last.progress, float(last.state[st.ROLL])),)
        return replace(last, step=self._step, time=time, fallen=True, fall=DIVERGED, events=fall)
