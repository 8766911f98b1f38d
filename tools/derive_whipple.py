"""Derive the nonlinear Whipple bicycle and write `bike_sim/physics/bicycle/whipple_equations.py`.

    python tools/derive_whipple.py            # rewrite the module
    python tools/derive_whipple.py --check    # exit 1 if the module is not what this script writes

Method: Kane's equations (principle of virtual power) with the independent speeds ``u = (roll rate, steer rate,
front wheel rate)``. The two wheels turn about axes of symmetry, so the bicycle is two rigid bodies, each with a
rotor: rear frame + rear wheel in the axes of the rear frame, fork + front wheel in the axes of the fork. For each

    m v_r . (a0 + g z) + w_r . (I alpha0 + w x (I w + J W y)) + J W_r dW0        (r = 1..3)

is the force that rate r has to overcome, where ``v_r, w_r, W_r`` are the partial velocities of the centre of mass,
the partial angular velocities and the partial total spins of the rotor (inertia J about its axle y, moved out of
I), and ``a0, alpha0, dW0`` are the accelerations with du/dt = 0. The mass matrix is the same sum over products of
partial velocities.

Every intermediate quantity is a named symbol, and its time derivative is formed by the chain rule from those of
the symbols in it. So no expression ever grows, and what is written reads like the derivation.

Frames (z up): the yaw frame at the rear contact P; the rear body's axes turned about y so that z lies along the
steering axis (``Rx(roll) Ry(beta)``, ``beta = pitch - lam``); the fork's axes (the same turned by the steer angle
about z). Kinematics as in `bike_sim.physics.kinematics`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import sympy as sp

TARGET = Path(__file__).parents[1] / "ros_ws/src/bike_sim/bike_sim/physics/bicycle/whipple_equations.py"

CONSTANTS = (
    *("rR", "rF", "d1", "fx", "fz", "g"),  # geometry of the ground constraint and gravity
    *("m1", "x1", "z1", "I1xx", "I1xz", "I1yy", "I1zz", "JR"),  # rear: frame + wheel, axial inertia of the wheel apart
    *("m2", "x2", "z2", "I2xx", "I2xz", "I2yy", "I2zz", "JF"),  # front: fork + wheel, likewise
)
TRIGONOMETRY = ("sr", "cr", "sb", "cb", "ss", "cs")
SPEEDS = ("roll_rate", "steer_rate", "front_wheel_rate")
Vector = Sequence[sp.Expr]


class Derivation:
    """A list of assignments in the order of their making, and the time derivatives that belong to them."""

    def __init__(self) -> None:
        """Start with the constants, the sines and cosines, and the speeds, whose own derivatives are left out."""
        names = (*CONSTANTS, *TRIGONOMETRY, *SPEEDS, "torque")
        self.symbols: dict[str, sp.Symbol] = {name: sp.Symbol(name, real=True) for name in names}
        self.assignments: list[tuple[sp.Symbol, sp.Expr]] = []
        self._rates: dict[sp.Symbol, sp.Expr] = {}

    def __getitem__(self, name: str) -> sp.Symbol:
        """Return the symbol of this name."""
        return self.symbols[name]

    def let(self, name: str, expression: sp.Expr) -> sp.Expr:
        """Name an expression; numbers and single symbols stay what they are."""
        expression = sp.sympify(expression)
        if expression.is_Number or expression.is_Symbol or (-expression).is_Symbol:
            return expression
        symbol = sp.Symbol(name, real=True)
        if name in self.symbols:
            raise ValueError(f"'{name}' is named twice")
        self.symbols[name] = symbol
        self.assignments.append((symbol, expression))
        return symbol

    def set_rate(self, name: str, rate: sp.Expr) -> None:
        """State the time derivative of a symbol that is given, not assigned."""
        self._rates[self[name]] = rate

    def rate(self, expression: sp.Expr) -> sp.Expr:
        """Return the time derivative at constant independent speeds."""
        definitions = dict(self.assignments)
        total = sp.Integer(0)
        for symbol in sorted(sp.sympify(expression).free_symbols, key=str):
            if symbol not in self._rates:
                inner = self.rate(definitions[symbol]) if symbol in definitions else sp.Integer(0)
                self._rates[symbol] = self.let(f"{symbol}_dot", inner)
            total += sp.diff(expression, symbol) * self._rates[symbol]
        return total


def cross(a: Vector, b: Vector) -> list[sp.Expr]:
    """Return the vector product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a: Vector, b: Vector) -> sp.Expr:
    """Return the scalar product."""
    return sum((x * y for x, y in zip(a, b, strict=True)), sp.Integer(0))


def add(*vectors: Vector) -> list[sp.Expr]:
    """Return the sum of vectors."""
    return [sum(parts, sp.Integer(0)) for parts in zip(*vectors, strict=True)]


def named(d: Derivation, name: str, vector: Vector) -> list[sp.Expr]:
    """Name the three components of a vector."""
    return [d.let(f"{name}_{axis}", part) for axis, part in zip("xyz", vector, strict=True)]


def dependent_speeds(d: Derivation) -> list[dict[str, sp.Expr]]:
    """Solve the rolling constraints; return the speeds at a unit of each independent speed, then the actual ones.

    See `bike_sim.physics.kinematics.velocities` for the same three equations.
    """
    sr, cr, sb, cb, ss, cs = (d[name] for name in TRIGONOMETRY)
    # axle direction of the front wheel, front contact Q from P, and from the head point S
    nx = d.let("nx", -cb * ss)
    ny = d.let("ny", cr * cs - sr * sb * ss)
    nz = d.let("nz", sr * cs + cr * sb * ss)
    inv_k = d.let("inv_k", 1 / sp.sqrt(nx**2 + ny**2))
    down = d.let("down", d["rF"] * nz * inv_k)
    along = d.let("along", d["d1"] + d["fx"] * cs)
    rise = d.let("rise", along * sb - d["fz"] * cb - d["rR"])
    qx = d.let("qx", along * cb + d["fz"] * sb + down * nx)
    qy = d.let("qy", rise * sr + d["fx"] * ss * cr + down * ny)
    head = d.let("head", d["rR"] - d["d1"] * sb)
    b = [d.let("bx", qx - d["d1"] * cb), d.let("by", qy + head * sr), d.let("bz", -head * cr)]
    axis = [sb, d.let("axis_y", -sr * cb), d.let("axis_z", cr * cb)]
    arm = named(d, "arm", cross(axis, b))
    inv_qx = d.let("inv_qx", 1 / qx)
    lever = d.let("lever", inv_qx / cr)
    pitch = [d.let("pitch_roll", qy * lever), d.let("pitch_steer", arm[2] * lever), sp.Integer(0)]
    turn = d.let("turn", d["rF"] * inv_k)
    yaw = [
        d.let("yaw_roll", -pitch[0] * sr),
        d.let("yaw_steer", -arm[1] * inv_qx - pitch[1] * sr),
        d.let("yaw_wheel", -turn * nx * inv_qx),
    ]
    speed = [
        d.let("speed_roll", pitch[0] * d["rR"]),
        d.let("speed_steer", pitch[1] * d["rR"] - arm[1] * inv_qx * qy - arm[0]),
        d.let("speed_wheel", turn * ny + yaw[2] * qy),
    ]
    u = [d[name] for name in SPEEDS]
    columns = []
    for r in range(3):
        unit = dict(zip(("roll", "steer", "wheel"), (sp.Integer(int(i == r)) for i in range(3)), strict=True))
        columns.append({"yaw": yaw[r], "speed": speed[r], "pitch": pitch[r], **unit})
    columns.append(
        {
            "pitch": d.let("pitch_rate", dot(pitch, u)),
            "yaw": d.let("yaw_rate", dot(yaw, u)),
            "speed": d.let("rear_speed", dot(speed, u)),
            **dict(zip(("roll", "steer", "wheel"), u, strict=True)),
        }
    )
    return columns


def body_speeds(d: Derivation, tag: str, s: dict[str, sp.Expr]) -> list[tuple[Vector, Vector, sp.Expr]]:
    """Return (velocity of the centre of mass, angular velocity, total spin of the wheel) of both bodies."""
    sr, cr, sb, cb, ss, cs = (d[name] for name in TRIGONOMETRY)
    w1 = named(
        d,
        f"w1{tag}",
        [
            s["roll"] * cb - s["yaw"] * cr * sb,
            s["pitch"] + s["yaw"] * sr,
            s["roll"] * sb + s["yaw"] * cr * cb,
        ],
    )
    hub_speed = d.let(f"hub{tag}", s["speed"] + d["rR"] * s["yaw"] * sr)
    hub = named(d, f"vR{tag}", [cb * hub_speed, -d["rR"] * s["roll"], sb * hub_speed])
    v1 = named(d, f"v1{tag}", add(hub, cross(w1, [d["x1"], 0, d["z1"]])))
    spin1 = d.let(f"spin1{tag}", hub_speed / d["rR"])
    vs = named(d, f"vS{tag}", add(hub, cross(w1, [d["d1"], 0, 0])))
    w2 = named(d, f"w2{tag}", [cs * w1[0] + ss * w1[1], cs * w1[1] - ss * w1[0], w1[2] + s["steer"]])
    v2 = named(
        d,
        f"v2{tag}",
        add([cs * vs[0] + ss * vs[1], cs * vs[1] - ss * vs[0], vs[2]], cross(w2, [d["x2"], 0, d["z2"]])),
    )
    spin2 = d.let(f"spin2{tag}", w2[1] + s["wheel"])
    return [(v1, w1, spin1), (v2, w2, spin2)]


def body_constants(d: Derivation) -> list[tuple[sp.Expr, sp.Matrix, sp.Expr]]:
    """Return (mass, inertia without the wheel's axial part, axial inertia of the wheel) of both bodies."""
    result = []
    for i, rotor in ((1, "JR"), (2, "JF")):
        xx, xz, yy, zz = (d[f"I{i}{name}"] for name in ("xx", "xz", "yy", "zz"))
        result.append((d[f"m{i}"], sp.Matrix([[xx, 0, xz], [0, yy, 0], [xz, 0, zz]]), d[rotor]))
    return result


def vertical(d: Derivation) -> list[Vector]:
    """Return the upward direction in the axes of both bodies."""
    sr, cr, sb, cb, ss, cs = (d[name] for name in TRIGONOMETRY)
    up1 = [d.let("up1_x", -cr * sb), sr, d.let("up1_z", cr * cb)]
    up2 = [d.let("up2_x", cs * up1[0] + ss * up1[1]), d.let("up2_y", cs * up1[1] - ss * up1[0]), up1[2]]
    return [up1, up2]


def start() -> Derivation:
    """Return a derivation that knows how the sines and cosines change."""
    d = Derivation()
    for sine, cosine, angle_rate in (("sr", "cr", SPEEDS[0]), ("ss", "cs", SPEEDS[1])):
        d.set_rate(sine, d[cosine] * d[angle_rate])
        d.set_rate(cosine, -d[sine] * d[angle_rate])
    return d


def equations_of_motion() -> tuple[Derivation, list[sp.Expr]]:
    """Return the derivation and (yaw rate, rear speed, pitch rate, three accelerations)."""
    d = start()
    columns = dependent_speeds(d)
    actual = columns[3]
    d.set_rate("sb", d["cb"] * actual["pitch"])
    d.set_rate("cb", -d["sb"] * actual["pitch"])
    partial = [body_speeds(d, f"_{r}", columns[r]) for r in range(3)]
    moving = body_speeds(d, "", actual)
    mass: dict[tuple[int, int], sp.Expr] = {(r, c): sp.Integer(0) for r in range(3) for c in range(r + 1)}
    force: list[sp.Expr] = [sp.Integer(0)] * 3
    for i, ((m, inertia, rotor), up) in enumerate(zip(body_constants(d), vertical(d), strict=True)):
        v, w, spin = moving[i]
        a0 = add([d.rate(part) for part in v], cross(w, v), [d["g"] * part for part in up])
        effort = named(d, f"f{i + 1}", [m * part for part in a0])
        momentum = named(d, f"h{i + 1}", add(inertia * sp.Matrix(w), [0, rotor * spin, 0]))
        moment = named(d, f"t{i + 1}", add(inertia * sp.Matrix([d.rate(part) for part in w]), cross(w, momentum)))
        spin_moment = d.let(f"k{i + 1}", rotor * d.rate(spin))
        for r in range(3):
            vr, wr, spin_r = partial[r][i]
            force[r] += dot(vr, effort) + dot(wr, moment) + spin_r * spin_moment
            vr_m = named(d, f"p{i + 1}_{r}", [m * part for part in vr])
            wr_i = named(d, f"l{i + 1}_{r}", list(inertia * sp.Matrix(wr)))
            spin_j = d.let(f"s{i + 1}_{r}", rotor * spin_r)
            for c in range(r + 1):
                vc, wc, spin_c = partial[c][i]
                mass[r, c] += dot(vr_m, vc) + dot(wr_i, wc) + spin_j * spin_c
    torque = [sp.Integer(0), d["torque"], sp.Integer(0)]
    acceleration = solve_symmetric(d, mass, [t - f for t, f in zip(torque, force, strict=True)])
    return d, [actual["yaw"], actual["speed"], actual["pitch"], *acceleration]


def solve_symmetric(d: Derivation, a: dict[tuple[int, int], sp.Expr], b: Sequence[sp.Expr]) -> list[sp.Expr]:
    """Solve the symmetric positive definite 3x3 system by its L D L^T factors."""
    m = {key: d.let(f"M{key[0]}{key[1]}", value) for key, value in a.items()}
    r = [d.let(f"r{i}", value) for i, value in enumerate(b)]
    inv0 = d.let("inv0", 1 / m[0, 0])
    l10, l20 = d.let("l10", m[1, 0] * inv0), d.let("l20", m[2, 0] * inv0)
    inv1 = d.let("inv1", 1 / (m[1, 1] - l10 * m[1, 0]))
    l21 = d.let("l21", (m[2, 1] - l20 * m[1, 0]) * inv1)
    inv2 = d.let("inv2", 1 / (m[2, 2] - l20 * m[2, 0] - l21**2 / inv1))
    y1 = d.let("y1", r[1] - l10 * r[0])
    x2 = d.let("front_wheel_acc", (r[2] - l20 * r[0] - l21 * y1) * inv2)
    x1 = d.let("steer_acc", y1 * inv1 - l21 * x2)
    x0 = d.let("roll_acc", r[0] * inv0 - l10 * x1 - l20 * x2)
    return [x0, x1, x2]


def energies() -> tuple[Derivation, list[sp.Expr]]:
    """Return the derivation and (kinetic energy, potential energy above the ground)."""
    d = start()
    actual = dependent_speeds(d)[3]
    moving = body_speeds(d, "", actual)
    kinetic = sp.Integer(0)
    for (v, w, spin), (m, inertia, rotor) in zip(moving, body_constants(d), strict=True):
        kinetic += (m * dot(v, v) + dot(w, list(inertia * sp.Matrix(w))) + rotor * spin**2) / 2
    up1, up2 = vertical(d)
    hub = d["rR"] * d["cr"]
    potential = d["m1"] * (hub + d["x1"] * up1[0] + d["z1"] * up1[2])
    potential += d["m2"] * (hub + d["d1"] * up1[0] + d["x2"] * up2[0] + d["z2"] * up2[2])
    return d, [d.let("kinetic", kinetic), d.let("potential", d["g"] * potential)]


def straight_line_code(d: Derivation, results: Sequence[sp.Expr]) -> list[str]:
    """Return assignments for what the results need, common subexpressions taken out, each line one assignment."""
    definitions = dict(d.assignments)
    needed: list[sp.Symbol] = []

    def visit(expression: sp.Expr) -> None:
        for symbol in sorted(expression.free_symbols, key=str):
            if symbol in definitions and symbol not in needed:
                visit(definitions[symbol])
                needed.append(symbol)

    for result in results:
        visit(result)
    replacements, reduced = sp.cse([definitions[symbol] for symbol in needed], symbols=sp.numbered_symbols("e"))
    pending = dict([*replacements, *zip(needed, reduced, strict=True)])
    lines: list[str] = []
    written: set[sp.Symbol] = set()

    def write(symbol: sp.Symbol) -> None:
        for inner in sorted(pending[symbol].free_symbols, key=str):
            if inner in pending and inner not in written:
                write(inner)
        written.add(symbol)
        lines.append(f"{symbol} = {sp.pycode(pending[symbol], fully_qualified_modules=True)}")

    for symbol in needed:
        if symbol not in written:
            write(symbol)
    return lines


def function(name: str, summary: str, arguments: Sequence[str], d: Derivation, results: Sequence[sp.Expr]) -> str:
    """Return the text of one compiled function."""
    lines = straight_line_code(d, results)
    operations = sum(sp.count_ops(value) for _, value in d.assignments)
    print(f"{name}: {len(lines)} assignments from {operations} operations", file=sys.stderr)
    body = [
        f'    """{summary}"""',
        f"    {', '.join(TRIGONOMETRY)} = angles",
        f"    {', '.join(SPEEDS)} = rates",
        f"    ({', '.join(CONSTANTS)}) = constants",
        *(f"    {line}" for line in lines),
        f"    return {', '.join(str(result) for result in results)}",
    ]
    # Strict arithmetic: relaxed, the same step compiled in two processes may differ in the last bit.
    given = "".join(f"{argument}: float, " for argument in arguments)
    head = f"@njit(cache=True)\ndef {name}(angles: Angles, rates: Rates, {given}constants: Constants) -> "
    head += f"tuple[{', '.join(['float'] * len(results))}]:\n"
    return head + "\n".join(body) + "\n"


HEADER = '''"""Equations of motion of the nonlinear Whipple bicycle. Written by tools/derive_whipple.py: do not edit.

Names are explained in the script that wrote this file.
"""

# ruff: noqa: E501
# fmt: off
from __future__ import annotations

import math

from numba import njit

Constants = tuple[
    float, float, float, float, float, float, float, float, float, float, float,
    float, float, float, float, float, float, float, float, float, float, float,
]
"""CONSTANT_NAMES in this order, made by `bike_sim.physics.bicycle.whipple.constants`."""
Angles = tuple[float, float, float, float, float, float]
"""Sines and cosines of roll, of beta = pitch - lam, and of steer: sr, cr, sb, cb, ss, cs."""
Rates = tuple[float, float, float]
"""Of roll, steer and front wheel, rad/s."""

'''


def module_text() -> str:
    """Return the whole text of the generated module."""
    names = ", ".join(f'"{name}"' for name in CONSTANTS)
    text = HEADER + f"CONSTANT_NAMES = ({names})\n\n\n"
    d, results = equations_of_motion()
    text += function(
        "motion",
        "Return (yaw rate, rear speed, pitch rate, roll, steer and front wheel acceleration), rad, m, s.",
        ("torque",),
        d,
        results,
    )
    d, results = energies()
    text += "\n\n" + function(
        "energies",
        "Return (kinetic energy, potential energy above the ground), J.",
        (),
        d,
        results,
    )
    return text


def main() -> int:
    """Write or check the generated module; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    arguments = parser.parse_args()
    text = module_text()
    if not arguments.check:
        TARGET.write_text(text, encoding="utf-8")
        # numba looks only at the file of the outermost compiled function, so that one must be newer than its cache
        TARGET.with_name("whipple.py").touch()
        return 0
    if TARGET.read_text(encoding="utf-8") == text:
        return 0
    print(f"{TARGET.name} differs from what this script writes: run it again", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
