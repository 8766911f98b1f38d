"""Model predictive control: the LQR's problem with limits, solved anew at every control instant.

Over a horizon the lean and the set value are limited; beyond it the LQR's cost takes over, with the path that is still
in preview. Where no limit is met, the first command is the LQR's. The problem is a convex quadratic programme, solved
by OSQP (Stellato et al. 2020, OSQP: an operator splitting solver for quadratic programs, Math. Prog. Comp. 12), sparse,
with states and commands as unknowns. The limit of the lean is soft, so that there is always an answer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import osqp
from numpy.typing import NDArray
from scipy import sparse

from bike_policy.riders.lqr import LqrRider, LqrSettings, control_problem, design
from bike_sim.course.course import Course
from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.request import Preview
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]

_SOLVED: Final = ("solved", "solved inaccurate")


@dataclass(frozen=True)
class MpcSettings:
    """Limits and horizon.

    Attributes:
        steps: control periods in which limits hold.
        lean: largest lean, rad.
        excess: weight of the squared tangent of the lean beyond it.
        accuracy: of the solver, absolute and relative. A coarser one blurs the answers to small deviations: at 1e-4 the
            loop was no longer stable about a straight at 7 m/s, which it is with exact answers.
        iterations: of the solver, at most.
    """

    steps: int = 30
    lean: float = math.radians(40.0)
    excess: float = 1e3
    accuracy: float = 1e-6
    iterations: int = 4000


class Programme(NamedTuple):
    """The quadratic programme of one speed; its vectors are filled in at each control instant.

    Attributes:
        solver: with the matrices.
        first: a of the model, which the present state comes in through, shape (n, n).
        cross: cost of the present state with the first command, shape (n,).
        curvature_effect: effect of a curvature, shape (n,).
        tail: what a curvature beyond the horizon costs at its end, one row for each period, shape (periods, n).
        linear: linear cost; its last block of states and its first command change.
        lower: bounds of the constraints.
        upper: the same from above.
    """

    solver: Any
    first: FloatArray
    cross: FloatArray
    curvature_effect: FloatArray
    tail: FloatArray
    linear: FloatArray
    lower: FloatArray
    upper: FloatArray


def programme(vehicle: Vehicle, speed: float, period: float, weights: LqrSettings, settings: MpcSettings) -> Programme:
    """Return the programme at a speed.

    The unknowns are the states after each of N periods, then N commands, then N excesses of the lean.

    Args:
        vehicle: bicycle.
        speed: m/s.
        period: control period, s.
        weights: of the LQR.
        settings: limits and horizon.
    """
    a, b, curvature_effect, cost, cross, control = control_problem(vehicle, speed, period, weights)
    gains = design(vehicle, speed, period, weights)
    count, size = settings.steps, len(b)
    later = sparse.eye_array(count, k=1)  # row k: state after period k meets command k + 1
    quadratic = sparse.block_diag([*[cost] * (count - 1), gains.to_go, control * np.eye(count)])
    mixed = sparse.kron(later, cross[:, None])
    corner = sparse.bmat([[None, mixed], [mixed.T, None]])
    unknowns = sparse.block_diag([quadratic + corner, settings.excess * sparse.eye_array(count)])
    moves = sparse.hstack(
        [
            sparse.kron(sparse.eye_array(count), np.eye(size)) - sparse.kron(sparse.eye_array(count, k=-1), a),
            sparse.kron(sparse.eye_array(count), -b[:, None]),
            sparse.csr_array((count * size, count)),
        ]
    )
    lean = sparse.kron(sparse.eye_array(count), np.eye(size)[2:3])
    nothing, one = sparse.csr_array((count, count)), sparse.eye_array(count)
    limits = sparse.vstack(
        [
            sparse.hstack([lean, nothing, -one]),
            sparse.hstack([lean, nothing, one]),
            sparse.hstack([sparse.csr_array((count, count * size)), one, nothing]),
        ]
    )
    steep, far = math.tan(settings.lean), np.full(count, np.inf)
    sharp = math.tan(vehicle.max_steer)
    still = np.zeros(count * size)
    lower = np.concatenate([still, -far, np.full(count, -steep), np.full(count, -sharp)])
    upper = np.concatenate([still, np.full(count, steep), far, np.full(count, sharp)])
    linear = np.zeros(unknowns.shape[0])
    solver = osqp.OSQP()
    solver.setup(
        P=sparse.csc_matrix(2.0 * sparse.triu(unknowns)),
        q=linear,
        A=sparse.csc_matrix(sparse.vstack([moves, limits])),
        l=lower,
        u=upper,
        verbose=False,
        eps_abs=settings.accuracy,
        eps_rel=settings.accuracy,
        max_iter=settings.iterations,
        adaptive_rho_interval=50,  # by default chosen by the clock, and no two rides would be the same
    )
    rest, tail = gains.closed.T @ gains.to_go @ curvature_effect, []
    for _ in range(max(len(gains.preview) - count, 0)):
        tail.append(rest)
        rest = gains.closed.T @ rest
    return Programme(solver, a, cross, curvature_effect, np.array(tail).reshape(-1, size), linear, lower, upper)


class MpcRider(LqrRider):
    """Rides a bicycle along any line within limits; implements `bike_policy.riders.base.Rider`."""

    name = "mpc"

    def __init__(self, weights: LqrSettings | None = None, settings: MpcSettings | None = None) -> None:
        """Take weights and limits."""
        super().__init__(weights)
        self._limits = settings or MpcSettings()

    def begin(self, vehicle: Vehicle, course: Course, period: float, preview: Preview) -> None:
        """Take the line and forget earlier solutions, so that a ride does not depend on the one before."""
        super().begin(vehicle, course, period, preview)
        self.designs = {key: found for key, found in self.designs.items() if key[0] != "_programme"}

    def turn(self, look: FloatArray, state: st.StateVector) -> float:
        """Return the first command of the programme; the LQR's where the solver finds none."""
        plan, count = self._nearest(self._programme, look[lk.SPEED]), self._limits.steps
        now, size = self.deviations(look, state), len(plan.curvature_effect)
        curvature = self.ahead(look, count + len(plan.tail))
        plan.linear[(count - 1) * size : count * size] = 2.0 * curvature[count:] @ plan.tail
        plan.linear[count * size] = 2.0 * float(plan.cross @ now)
        moved = np.outer(curvature[:count], plan.curvature_effect).ravel()
        moved[:size] += plan.first @ now
        plan.lower[: len(moved)] = plan.upper[: len(moved)] = moved
        plan.solver.update(q=plan.linear, l=plan.lower, u=plan.upper)
        result = plan.solver.solve(raise_error=False)
        if result.info.status not in _SOLVED:
            return super().turn(look, state)
        return float(result.x[count * size])

    def _programme(self, speed: float) -> Programme:
        """Return the programme at a speed, m/s."""
        return programme(self._vehicle, speed, self._period, self._settings, self._limits)
