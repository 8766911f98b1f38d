"""Twelve measured bicycles: eigenvalues against the engine, a second evaluation, and published ranges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bike_sim.physics.bicycle import linear
from bike_sim.validation.parameters import SPEEDS, measured_bicycles, read_parameters
from bike_sim.vehicles.parameters import VehicleError

FOLDER = Path(__file__).with_name("bicycles")
NAMES = sorted(path.stem for path in FOLDER.glob("*.txt"))
STABLE = {  # m/s, of another program
    "Balanceassistv1": (3.4421, 4.3526),
    "Benchmark": (4.2924, 6.0243),
    "Browser": (4.1954, 4.3501),
    "Browserins": (4.0327, 4.2949),
    "Crescendo": (4.8046, 6.1052),
    "Fisher": (3.8040, 6.1348),
    "Pista": (3.6743, 5.4652),
    "Rigid": (5.0084, 6.4291),
    "Silver": (3.9858, 7.8956),
    "Yellow": (3.4769, 4.6842),
}


def moved(mass: float, arm: np.ndarray) -> np.ndarray:
    """Return the inertia tensor of a point mass at an arm."""
    return mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def second_evaluation(name: str, speed: float) -> np.ndarray:
    """Return the eigenvalues from tensors about the rear contact and about the steering axis (x ahead, z down)."""
    b = read_parameters(FOLDER / f"{name}.txt")

    def body(mass: float, x: float, z: float, xx: float, zz: float, xz: float = 0.0) -> tuple[float, np.ndarray, float]:
        tensor = np.array([[xx, 0.0, xz], [0.0, 0.0, 0.0], [xz, 0.0, zz]])
        return mass, np.array([x, 0.0, z]), tensor

    rear = [body(b.mR, 0.0, -b.rR, b.IRxx, b.IRxx), body(b.mB, b.xB, b.zB, b.IBxx, b.IBzz, b.IBxz)]
    front = [body(b.mH, b.xH, b.zH, b.IHxx, b.IHzz, b.IHxz), body(b.mF, b.w, -b.rF, b.IFxx, b.IFxx)]
    axis = np.array([np.sin(b.lam), 0.0, np.cos(b.lam)])
    trail = b.c * np.cos(b.lam) / b.w
    point = np.array([b.w + b.c, 0.0, 0.0])  # of the steering axis
    turn = np.array([0.0, 0.0, 1.0])
    # velocities of each body for a unit of roll rate and of steer rate: what keeps the contacts rolls along
    inertia, gravity = np.zeros((2, 2)), np.zeros((2, 2))
    damping, speedy = np.zeros((2, 2)), np.zeros((2, 2))
    yaw_by_steer, yaw_by_steer_rate = np.cos(b.lam) / b.w, trail
    roll = np.array([1.0, 0.0, 0.0])
    for bodies, steers in ((rear, 0.0), (front, 1.0)):
        for mass, at, tensor in bodies:
            spins = (roll, trail * turn + steers * axis)
            aside = (-at[2], trail * at[0] + steers * np.cross(axis, at - point)[1])
            # of a unit of yaw acceleration at this speed, and of the rear contact's sideways speed v yaw
            for i in range(2):
                for j in range(2):
                    inertia[i, j] += mass * aside[i] * aside[j] + spins[i] @ tensor @ spins[j]
                acceleration = mass * aside[i] * at[0] + spins[i] @ tensor @ turn
                damping[i, 1] += yaw_by_steer * acceleration + yaw_by_steer_rate * mass * aside[i]
                speedy[i, 1] += yaw_by_steer * mass * aside[i]
            if steers:
                lever = np.cross(axis, at - point)[1]
                gravity[0, 1] -= mass * lever
                gravity[1, 1] -= mass * lever * np.sin(b.lam)
            gravity[0, 0] += mass * at[2]
    total = sum(mass * at[0] for mass, at, _ in rear + front)
    gravity[0, 1] -= trail * total
    gravity[1, 1] -= trail * total * np.sin(b.lam)
    gravity[1, 0] = gravity[0, 1]
    spin_r, spin_f = (i / r if r else 0.0 for i, r in ((b.IRyy, b.rR), (b.IFyy, b.rF)))
    gyro = trail * (spin_r + spin_f) + spin_f * np.cos(b.lam)
    damping[0, 1] += gyro
    damping[1, 0] -= gyro
    speedy[0, 1] += (spin_r + spin_f) * yaw_by_steer
    speedy[1, 1] += spin_f * np.sin(b.lam) * yaw_by_steer
    matrix = np.zeros((4, 4))
    matrix[:2, 2:] = np.eye(2)
    matrix[2:, :2] = -np.linalg.solve(inertia, b.g * gravity + speed**2 * speedy)
    matrix[2:, 2:] = -np.linalg.solve(inertia, speed * damping)
    return np.linalg.eigvals(matrix)


@pytest.mark.parametrize("name", NAMES)
def test_eigenvalues_of_a_second_evaluation(name: str) -> None:
    """Newton and Euler body by body give those of the closed formulas to 1e-6."""
    for speed in SPEEDS:
        ours = np.linalg.eigvals(linear.state_matrix(read_parameters(FOLDER / f"{name}.txt"), speed))
        error = np.abs(np.subtract.outer(ours, second_evaluation(name, speed))).min(axis=0).max()
        assert error < 1e-6, (speed, ours, second_evaluation(name, speed))


@pytest.mark.parametrize("name", ["Browser", "Pista", "Yellowrev"])
def test_eigenvalues_on_the_engine_and_the_range_of_balance(name: str) -> None:
    (found,) = measured_bicycles(FOLDER / f"{name}.txt")
    check = found.check()
    assert check is not None
    assert check.passed, check.measured
    if name in STABLE:
        assert found.stable == pytest.approx(STABLE[name], abs=6e-5)


def test_what_is_no_parameter_is_refused(tmp_path: Path) -> None:
    """A line that is none, and a file that lacks one, by name."""
    text = (FOLDER / "Browser.txt").read_text(encoding="utf-8")
    for wrong, message in ((text + "xB = wide", "'xB = wide' is not"), (text.replace("mH =", "mh ="), "lack mH")):
        (tmp_path / "mine.txt").write_text(wrong, encoding="utf-8")
        with pytest.raises(VehicleError, match=message):
            read_parameters(tmp_path / "mine.txt")
