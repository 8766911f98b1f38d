"""The benchmark bicycle in Exudyn, the multibody code of Weyrer et al. (2026), for comparison only.

It is built of Exudyn's own elements, as the smallest system that Exudyn offers: a kinematic tree of nine joint
coordinates with two ideal rolling discs, and the steering drive inside the solver. It implements
`bike_sim.physics.engine.BicycleEngine` but for pushes, so that the same identification of modes measures its accuracy.
Exudyn (https://exudyn.readthedocs.io) is a development dependency; nothing that is shipped imports it.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import math
import sys
from typing import Any, Final

import numpy as np

from bike_sim.physics import bodies as bd
from bike_sim.physics import kinematics
from bike_sim.physics import state as st
from bike_sim.physics.engine import BicycleEngine
from bike_sim.physics.ground import LEVEL, Ground
from bike_sim.physics.state import StateVector
from bike_sim.vehicles.bicycle import Vehicle

# The build without range checks; Exudyn looks for this name when it is first imported, and announces its choice.
sys.exudynFast = True  # type: ignore[attr-defined]
with contextlib.redirect_stdout(io.StringIO()):
    # by name, because its stub files describe some of the calls wrongly
    exudyn: Any = importlib.import_module("exudyn")
    items: Any = importlib.import_module("exudyn.itemInterface")

METHODS: Final = ("trapezoidal", "generalized_alpha")

# Joint coordinates of the tree; the first six carry the rear axle and the frame.
_YAW, _ROLL, _REAR, _STEER, _FRONT = 3, 4, 6, 7, 8


class ExudynBicycle(BicycleEngine):
    """The bicycle as a kinematic tree with joint coordinates, and its solver."""

    def __init__(
        self, vehicle: Vehicle, time_step: float, method: str = "trapezoidal", tolerance: float = 1e-8
    ) -> None:
        """Build the model and its solver.

        Args:
            vehicle: the bicycle.
            time_step: integration step, s.
            method: one of `METHODS`.
            tolerance: relative tolerance of Newton's method; Exudyn's default is 1e-8.

        Raises:
            ValueError: unknown method, or the time step is not positive and finite.
        """
        super().__init__(vehicle, time_step)
        if method not in METHODS:
            raise ValueError(f"unknown method '{method}'; choose one of {', '.join(METHODS)}")
        self._container = exudyn.SystemContainer()
        self._system = self._container.AddSystem()
        self._build()
        self._system.Assemble()
        self._settings = exudyn.SimulationSettings()
        self._settings.solution.file.write = False
        self._settings.parallel.numberOfThreads = 1
        self._settings.linearSolver.solverType = exudyn.LinearSolverType.EXUdense  # faster than sparse at this size
        integration = self._settings.timeIntegration
        integration.verboseMode = 0
        integration.newton.useModifiedNewton = True  # twice as fast as building the Jacobian anew
        integration.newton.relativeTolerance = tolerance
        integration.generalizedAlpha.useNewmark = method == "trapezoidal"
        integration.generalizedAlpha.useIndex2Constraints = method == "trapezoidal"
        self._solver = exudyn.MainSolverImplicitSecondOrder()
        self._time = 0.0
        self.reset(st.upright_state(0.0, vehicle.rF))

    @property
    def fall(self) -> str:
        """Whether the roll is beyond the vehicle's limit, as the name of a fall."""
        self._state = self.state()
        return super().fall

    def reset(self, state: StateVector, ground: Ground = LEVEL) -> None:
        """Set a minimal state, positions and velocities; the discs roll on a level plane."""
        self._state = np.array(state)
        coordinates, rates = self._coordinates(self._state)
        data, current = self._system.systemData, exudyn.ConfigurationType.Current
        integration = self._settings.timeIntegration
        integration.startTime = integration.endTime = self._time = 0.0
        integration.numberOfSteps = 1
        for configuration in (exudyn.ConfigurationType.Initial, current):
            data.SetODE2Coordinates(coordinates, configuration)
            data.SetODE2Coordinates_t(rates, configuration)
        self._solver.InitializeSolver(self._system, self._settings)

    def hold(self, steer_set: float, steps: int) -> None:
        """Integrate with the set point held, in one call of the solver.

        Raises:
            RuntimeError: Newton's method did not converge.
        """
        self._set_drive(steer_set)
        integration = self._settings.timeIntegration
        integration.startTime = self._time
        self._time += steps * self.time_step
        integration.endTime = self._time
        integration.numberOfSteps = steps
        self._solver.InitializeSolverInitialConditions(self._system, self._settings)
        if not self._solver.SolveSteps(self._system, self._settings):
            raise RuntimeError("Exudyn's solver did not converge")
        # The end is where the next call starts, accelerations included.
        data, initial = self._system.systemData, exudyn.ConfigurationType.Initial
        data.SetSystemState(data.GetSystemState(), initial)
        data.SetODE2Coordinates_tt(data.GetODE2Coordinates_tt(), initial)

    def raw_coordinates(self) -> tuple[Any, Any]:
        """Return Exudyn's own coordinates and rates, the cheapest look at the result."""
        data = self._system.systemData
        return data.GetODE2Coordinates(), data.GetODE2Coordinates_t()

    def close(self) -> None:
        """Release nothing; Exudyn frees its system with the object."""

    def _build(self) -> None:
        vehicle, j = self.vehicle, exudyn.JointType
        reference, tensors = bd.layout(vehicle), bd.inertia_tensors(vehicle)
        rear, frame, fork, front = reference.centres
        c, s = math.cos(vehicle.lam), math.sin(vehicle.lam)
        tilt = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])  # the steering axis becomes z
        none, same, nothing = [0.0, 0.0, 0.0], np.eye(3), np.zeros((3, 3))
        drive = np.zeros(9)
        drive[_STEER] = 1.0
        node = self._system.AddNode(
            items.NodeGenericODE2(
                referenceCoordinates=[0.0] * 9,
                initialCoordinates=[0.0] * 9,
                initialCoordinates_t=[0.0] * 9,
                numberOfODE2Coordinates=9,
            )
        )
        self._tree = self._system.AddObject(
            items.ObjectKinematicTree(
                nodeNumber=node,
                gravity=[0.0, 0.0, -vehicle.g],
                jointTypes=[
                    *(j.PrismaticX, j.PrismaticY, j.PrismaticZ, j.RevoluteZ, j.RevoluteX, j.RevoluteY),
                    *(j.RevoluteY, j.RevoluteZ, j.RevoluteY),
                ],
                linkParents=[-1, 0, 1, 2, 3, 4, 5, 5, _STEER],
                jointTransformations=exudyn.Matrix3DList([same] * 7 + [tilt, tilt.T]),
                jointOffsets=exudyn.Vector3DList(
                    [none] * 7 + [reference.head - rear, tilt.T @ (front - reference.head)]
                ),
                linkMasses=[0.0] * 5 + [vehicle.mB, vehicle.mR, vehicle.mH, vehicle.mF],
                linkCOMs=exudyn.Vector3DList([none] * 5 + [frame - rear, none, tilt.T @ (fork - reference.head), none]),
                linkInertiasCOM=exudyn.Matrix3DList(
                    [nothing] * 5
                    + [
                        tensors[bd.REAR_FRAME],
                        tensors[bd.REAR_WHEEL],
                        tilt.T @ tensors[bd.FORK] @ tilt,
                        tensors[bd.FRONT_WHEEL],
                    ]
                ),
                jointPControlVector=vehicle.P * drive,
                jointDControlVector=vehicle.D * drive,
                jointPositionOffsetVector=0.0 * drive,
                jointVelocityOffsetVector=0.0 * drive,
            )
        )
        ground = self._system.AddMarker(items.MarkerBodyRigid(bodyNumber=self._system.AddObject(items.ObjectGround())))
        for link, radius in ((_REAR, vehicle.rR), (_FRONT, vehicle.rF)):
            hub = self._system.AddMarker(
                items.MarkerKinematicTreeRigid(objectNumber=self._tree, linkNumber=link, localPosition=none)
            )
            self._system.AddObject(
                items.ObjectJointRollingDisc(markerNumbers=[ground, hub], discRadius=radius, discAxis=[0.0, 1.0, 0.0])
            )

    def _coordinates(self, state: StateVector) -> tuple[Any, Any]:
        p = self.vehicle.parameters
        bodies = bd.redundant_from_minimal(state, self.vehicle)
        yaw_rate, _, pitch_rate = kinematics.rates(state, p)
        pitch = kinematics.pitch(state[st.ROLL], state[st.STEER], p)
        angles = [state[st.YAW], state[st.ROLL], pitch, state[st.REAR_WHEEL], state[st.STEER], state[st.FRONT_WHEEL]]
        rear_rate = kinematics.rear_wheel_rate(state, p)
        rates = [yaw_rate, state[st.ROLL_RATE], pitch_rate, rear_rate, state[st.STEER_RATE], state[st.FRONT_WHEEL_RATE]]
        axle = bd.REAR_WHEEL
        return np.concatenate([bodies.positions[axle], angles]), np.concatenate([bodies.velocities[axle], rates])

    def _set_drive(self, steer_set: float) -> None:
        offsets = [0.0] * 9
        offsets[_STEER] = steer_set
        self._system.SetObjectParameter(self._tree, "jointPositionOffsetVector", offsets)

    def state(self) -> StateVector:
        """Return the minimal state as a fresh vector of ten."""
        q, rates = self.raw_coordinates()
        lean = self.vehicle.rR * math.sin(q[_ROLL])
        x, y = q[0] - lean * math.sin(q[_YAW]), q[1] + lean * math.cos(q[_YAW])
        return np.array(
            [x, y, q[_YAW], q[_ROLL], q[_STEER], q[_REAR], q[_FRONT], rates[_ROLL], rates[_STEER], rates[_FRONT]]
        )
