"""A policy as one C header: observation, actor and action, in C99 without allocation, files or threads.

A header needs ``math.h`` and ``stdint.h`` alone, and computes in single precision. Policies of paths take named
quantities of the vehicle; those of races take the observation as `bike_policy.contract.observation` makes it, for it
is made of the plan of a lap.
"""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from textwrap import fill
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.action import GUIDED, MEANINGS, STEERING_SET_VALUE
from bike_policy.contract.bundle import Actor, Bundle
from bike_policy.contract.observation import LEAST_AHEAD, PATH_TERMS, ObservationLayout
from bike_sim.documents import alternatives
from bike_sim.schema import GRAVITY, LOOK, STATE
from bike_sim.vehicles.files import load_vehicle
from bike_training.learning_packages import DISTRIBUTION

WEIGHTS: Final[Mapping[str, tuple[str, float, int]]] = {"float": ("float", 10.0, 4), "int8": ("int8_t", 12.0, 1)}
"""Kinds of weights: type in C, cycles of a multiply-add on the microcontroller, and bytes.

Cycles are those of the Cortex-M4 technical reference manual (ARM DDI 0439): two loads of 2, a multiply-add of 3 and a
loop of 3; of an 8-bit weight a transfer and a conversion of 1 each besides.
"""
MICROCONTROLLER_HZ: Final = 168e6
"""Clock of the microcontroller that the operations are counted for: a Cortex-M4 with a floating-point unit."""
_TANH_CYCLES: Final = 200.0
"""Of a tanh in software; an assumption, and small beside the layers."""

_STATE_TERMS: Final = {
    "rear_wheel": "rear_wheel_angle",
    "front_wheel": "front_wheel_angle",
    **{name: name for name in ("x", "y", "roll", "steer", "roll_rate", "steer_rate", "front_wheel_rate")},
}
"""Terms that are a number of the state, with its name."""
_YAW_TERMS: Final = {
    "yaw_wrapped": "atan2f(sinf(in->yaw), cosf(in->yaw))",
    "yaw_cos": "cosf(in->yaw)",
    "yaw_sin": "sinf(in->yaw)",
}
_PREVIEW_TERMS: Final = ("preview_points", "preview_lean", "preview_turn")
_C_TERMS: Final = frozenset((*_STATE_TERMS, *_YAW_TERMS, *_PREVIEW_TERMS))


@dataclass(frozen=True)
class Header:
    """A policy's header.

    Attributes:
        prefix: with which its names begin.
        text: of the file.
        named: whether it makes the observation of named inputs; else it takes the observation.
        fields: names of these inputs, but for the preview's points.
        error: largest difference of its actor's actions to the policy's that comes from the weights' rounding.
        error_rms: the same, RMS.
        multiply_adds: of an answer.
        cycles: of an answer on the microcontroller, as counted.
        bytes: of the weights.
    """

    prefix: str
    text: str
    named: bool
    fields: tuple[str, ...]
    error: float
    error_rms: float
    multiply_adds: int
    cycles: float
    bytes: int


def rounded(actor: Actor) -> tuple[list[NDArray[np.int8]], list[NDArray[np.float32]], Actor]:
    """Return an actor with 8-bit weights.

    Returns:
        Of each layer the whole weights, shape (outputs, inputs), and the step of each output, shape (outputs,); and the
        actor with these weights.
    """
    whole, steps, weights = [], [], []
    for weight in (columns.T for columns in actor.weights):
        step = np.maximum(np.abs(weight).max(axis=1), np.finfo(np.float32).tiny) / np.float32(127.0)
        whole.append(np.rint(weight / step[:, None]).astype(np.int8))
        steps.append(step.astype(np.float32))
        weights.append(whole[-1] * steps[-1][:, None])
    return whole, steps, Actor(weights, actor.biases)


def make_header(bundle: Bundle, weights: str, observations: NDArray[np.float32], where: str) -> Header:
    """Return a policy as a C header.

    Args:
        bundle: the policy.
        weights: a key of `WEIGHTS`.
        observations: on which the error of the weights is found, shape (n, layout size).
        where: they were seen, for the header's comment.

    Raises:
        ValueError: unknown weights.
    """
    if weights not in WEIGHTS:
        raise ValueError(f"unknown weights {weights!r}; {alternatives(weights, WEIGHTS)}")
    kind, cycles_each, size = WEIGHTS[weights]
    actor, prefix = bundle.actor, re.sub(r"\W", "_", f"bike_{bundle.name}", flags=re.ASCII).lower()
    whole, steps, coarse = rounded(actor)
    errors = coarse.act_batch(observations) - actor.act_batch(observations) if weights == "int8" else np.zeros(1)
    error, rms = float(np.abs(errors).max()), float(np.sqrt(np.mean(errors**2)))
    layout = bundle.layout
    named = not layout.races and set(layout.terms) <= _C_TERMS
    speed = any(column.within for column in bundle.action.columns)
    fields = _fields(layout, speed) if named else ()
    multiply_adds = sum(columns.size for columns in actor.weights)
    cycles = multiply_adds * cycles_each + actor.outputs * _TANH_CYCLES
    count = sum(columns.size * size + (len(bias) * (8 if size == 1 else 4)) for columns, bias in _layers(actor))
    exactness = "the policy's own."
    if weights == "int8":
        exactness = (
            f"rounded to 8 bit with a factor for each output. An action differs from the policy's by {rms:.2g} (RMS), "
            f"{error:.2g} at most, on {len(observations)} observations of {where}."
        )
    body = [_comment(bundle, exactness, multiply_adds, cycles, count)]
    guard = f"{prefix.upper()}_H"
    body.append(f"#ifndef {guard}\n#define {guard}\n\n#include <math.h>\n#include <stdint.h>\n")
    body.append(
        f"#define {prefix.upper()}_OBSERVATION {layout.size}\n#define {prefix.upper()}_ACTION {bundle.action.size}\n"
    )
    if named:
        body.append(_observe(prefix, layout, fields))
    body += [_weights(prefix, kind, actor, whole, steps), _act(prefix, kind, actor)]
    body.append(_command(prefix, bundle, speed))
    if named:
        body.append(_answer(prefix, bundle, speed))
    text = "\n".join([*body, f"#endif  /* {guard} */\n"])
    return Header(prefix, text, named, fields, error, rms, multiply_adds, cycles, count)


def _layers(actor: Actor) -> Iterable[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    return zip(actor.weights, actor.biases, strict=True)


def _fields(layout: ObservationLayout, speed: bool) -> tuple[str, ...]:
    """Return the named inputs of a layout of paths, in the order of the state."""
    needed = {_STATE_TERMS[term] for term in layout.terms if term in _STATE_TERMS}
    if any(term in _YAW_TERMS for term in layout.terms):
        needed.add("yaw")
    return (*(name for name in STATE.names if name in needed), *(("speed",) if speed else ()))


def _comment(bundle: Bundle, exactness: str, multiply_adds: int, cycles: float, count: int) -> str:
    layout, actor = bundle.layout, bundle.actor
    sizes = " -> ".join(map(str, [actor.inputs, *(len(bias) for bias in actor.biases)]))
    stack = 4 * (2 * max(map(len, actor.biases)) + actor.inputs + actor.outputs)
    paragraphs = [
        f'Policy "{bundle.name}" of vehicle "{bundle.vehicle}", written by {DISTRIBUTION} {version(DISTRIBUTION)}. '
        f"To be asked every {bundle.control_period * layout.repeat:g} s. Layout {layout.name!r}, version "
        f"{layout.version}; layers {sizes}, ReLU, tanh.",
        f"Weights: {count} bytes, {exactness}",
        f"An answer: {multiply_adds} multiply-adds, {len(actor.biases[-1])} tanh; counted for a Cortex-M4 at "
        f"{MICROCONTROLLER_HZ / 1e6:g} MHz {cycles:.0f} cycles, {1e3 * cycles / MICROCONTROLLER_HZ:.2f} ms (not "
        f"measured on one). Stack: {stack} bytes and what the compiler adds. No allocation, no state between answers.",
    ]
    if layout.races:
        paragraphs.append(
            "The observation is the caller's: these numbers, in order, scaled and bounded as "
            f"bike_policy.contract.observation does: {', '.join(layout.names)}"
        )
    text = "\n\n   ".join(fill(text, 116, subsequent_indent="   ") for text in paragraphs)
    return f"/* {text.replace('*', '')} */\n"  # a name must not end the comment


def _number(value: float) -> str:
    """Return a number of single precision as C reads it back, bit for bit."""
    text = f"{float(np.float32(value)):.9g}"
    return f"{text if any(mark in text for mark in '.en') else text + '.0'}f"


def _array(kind: str, name: str, values: NDArray[Any]) -> str:
    numbers = [str(value) if kind == "int8_t" else _number(value) for value in values.ravel().tolist()]
    rows = fill(", ".join(numbers), 116, initial_indent="  ", subsequent_indent="  ")
    return f"static const {kind} {name}[{values.size}] = {{\n{rows}}};\n"


def _weights(
    prefix: str, kind: str, actor: Actor, whole: list[NDArray[np.int8]], steps: list[NDArray[np.float32]]
) -> str:
    parts = []
    for i, (columns, bias) in enumerate(_layers(actor)):
        parts.append(_array(kind, f"{prefix}_weight_{i}", whole[i] if kind == "int8_t" else columns.T))
        if kind == "int8_t":
            parts.append(_array("float", f"{prefix}_step_{i}", steps[i]))
        parts.append(_array("float", f"{prefix}_bias_{i}", bias))
    return "".join(parts)


def _act(prefix: str, kind: str, actor: Actor) -> str:
    widest = max(map(len, actor.biases))
    lines = [
        "/* Return a neuron's sum. */",
        f"static inline float {prefix}_sum(const {kind} *weight, const float *in, int count) {{",
        "  float sum = 0.0f;",
        "  for (int i = 0; i < count; ++i) sum += (float)weight[i] * in[i];",
        "  return sum;",
        "}",
        "",
        "/* Actor: from an observation to an action in [-1, 1]. */",
        f"static inline void {prefix}_act(const float *observation, float *action) {{",
        f"  float even[{widest}], odd[{widest}];",
    ]
    source = "observation"
    for i, (columns, bias) in enumerate(_layers(actor)):
        last = i == len(actor.weights) - 1
        target = "action" if last else ("even", "odd")[i % 2]
        step = f"{prefix}_step_{i}[n] * " if kind == "int8_t" else ""
        inputs = len(columns)
        lines += [
            f"  for (int n = 0; n < {len(bias)}; ++n) {{",
            f"    float value = {step}{prefix}_sum({prefix}_weight_{i} + {inputs} * n, {source}, {inputs}) "
            f"+ {prefix}_bias_{i}[n];",
            f"    {target}[n] = {'tanhf(value)' if last else 'value > 0.0f ? value : 0.0f'};",
            "  }",
        ]
        source = target
    unused = ["  (void)even;", "  (void)odd;"] if len(actor.weights) < 3 else []
    return "\n".join([*lines, *unused, "}\n"])


def _observe(prefix: str, layout: ObservationLayout, fields: tuple[str, ...]) -> str:
    quantities = {quantity.name: quantity for quantity in (*STATE, *LOOK)}
    lines = [
        "/* Inputs, SI; x forward, y left, z up; roll positive leaning right, yaw and steer positive to the left. */"
    ]
    lines.append("typedef struct {")
    lines += [f"  float {name};  /* {quantities[name].unit}: {quantities[name].meaning} */" for name in fields]
    basis = "s" if layout.preview_by_time else "m"
    lines += [
        "  /* m: ahead of the rear contact and to the left of its heading, of points of the line further on by",
        f"     0, {layout.preview_interval:g}, ... {layout.preview_interval * (layout.preview_count - 1):g} {basis} */",
        f"  float preview_x[{layout.preview_count}], preview_y[{layout.preview_count}];",
        f"}} {prefix}_inputs;\n",
        "/* Make the observation. */",
        f"static inline void {prefix}_observe(const {prefix}_inputs *in, float *observation) {{",
    ]
    factors = layout.factors or (1.0,) * len(layout.terms)
    for term, factor in zip(layout.terms, factors, strict=True):
        first, bound = layout.places[term].start, float(PATH_TERMS[term].bound)
        times = f"{_number(factor)} * " if factor != 1.0 else ""
        if term in _PREVIEW_TERMS:
            lines.append(f"  for (int k = 0; k < {layout.preview_count}; ++k) {{")
            lines.append("    float value = in->preview_y[k];")
            if term != "preview_points":
                step, scale = layout.preview_interval, _number(1.0 / (GRAVITY * layout.preview_interval**2))
                lines += [
                    f"    if (k == 1) value = (value - in->preview_y[0]) * {_number(1.0 / step)};",
                    "    if (k >= 2) {",
                    "      float next = value - in->preview_y[k - 1];",
                    "      float last = in->preview_y[k - 1] - in->preview_y[k - 2];",
                ]
                if term == "preview_turn":
                    lines += [
                        "      float along = in->preview_x[k] - in->preview_x[k - 1];",
                        "      float before = in->preview_x[k - 1] - in->preview_x[k - 2];",
                        f"      value = (before * next - last * along) * {scale}",
                        f"          / fmaxf(hypotf(before, last), {_number(LEAST_AHEAD)});",
                    ]
                else:
                    lines.append(f"      value = (next - last) * {scale};")
                lines.append("    }")
            lines += [f"    observation[{first} + k] = {times}value;", "  }"]
            continue
        value = _YAW_TERMS.get(term) or f"in->{_STATE_TERMS[term]}"
        if np.isfinite(bound):
            value = f"fmaxf({_number(-bound)}, fminf({_number(bound)}, {value}))"
        lines.append(f"  observation[{first}] = {times}{value};")
    return "\n".join([*lines, "}\n"])


_OUTPUTS: Final = {
    STEERING_SET_VALUE: "set point of the steering angle, rad, positive to the left",
    "lean_request": "steering in [-1, 1]: part of the virtual rider's largest lean, positive to the left",
    "throttle_and_brake": "throttle in [-1, 1]: above 0 part of the engine's torque, below 0 of the brakes' force",
    "line_offset": "target of the guide: distance from the followed line, m, positive to the left",
    "pace": "target of the guide: change of the planned speed as a part of it",
}
"""Meaning of what an action is turned into."""
assert set(_OUTPUTS) == set(MEANINGS)


def _command(prefix: str, bundle: Bundle, speed: bool) -> str:
    columns = bundle.action.columns
    lines = ["/* Turn an action into, in order:"]
    lines += [f"   {_OUTPUTS[column.meaning]}" for column in columns]
    head = f"static inline void {prefix}_command(const float *action, {'float speed, ' if speed else ''}float *command)"
    lines[-1] += " */"
    lines.append(head + " {")
    for i, column in enumerate(columns):
        steers = column.meaning == STEERING_SET_VALUE
        most = load_vehicle(bundle.vehicle).max_steer if steers else 1.0
        if not column.within:
            limit = None if column.meaning in GUIDED else _number(most)
        else:
            lines += _limit(column.within, most)
            limit = "limit"
        lines.append(f"  command[{i}] = {_number(column.scale)} * action[{i}];")
        if limit:
            lines.append(f"  command[{i}] = fmaxf(-{limit}, fminf({limit}, command[{i}]));")
    return "\n".join([*lines, "}\n"])


def _limit(within: tuple[tuple[float, float], ...], most: float) -> list[str]:
    """Return the lines that interpolate a limit by speed: linear between its pairs, constant beyond them."""
    speeds, values = zip(*((v, min(value, most)) for v, value in within), strict=True)
    lines = [f"  float limit = {_number(values[0])};"]
    for a, b, low, high in zip(speeds, speeds[1:], values, values[1:], strict=False):
        slope = (high - low) / (b - a)
        lines.append(f"  if (speed > {_number(a)}) limit = {_number(low)} + {_number(slope)} * (speed - {_number(a)});")
    return [*lines, f"  if (speed > {_number(speeds[-1])}) limit = {_number(values[-1])};"]


def _answer(prefix: str, bundle: Bundle, speed: bool) -> str:
    upper = prefix.upper()
    return "\n".join(
        [
            "/* Answer the vehicle's state with its command. */",
            f"static inline void {prefix}_answer(const {prefix}_inputs *in, float *command) {{",
            f"  float observation[{upper}_OBSERVATION], action[{upper}_ACTION];",
            f"  {prefix}_observe(in, observation);",
            f"  {prefix}_act(observation, action);",
            f"  {prefix}_command(action, {'in->speed, ' if speed else ''}command);",
            "}\n",
        ]
    )


# ------------------------------------------------------------------------------------------------------------ compiled

_FLOATS: Final = np.ctypeslib.ndpointer(np.float32, flags="C_CONTIGUOUS")


def compiler() -> str | None:
    """Return the C compiler of this machine, None without one."""
    return shutil.which("cc") or shutil.which("gcc")


class CompiledHeader:
    """A header compiled on this machine, to compare it with the policy that it was made of."""

    def __init__(self, header: Header) -> None:
        """Compile with warnings as errors.

        Raises:
            FileNotFoundError: there is no C compiler.
            ValueError: it does not compile.
        """
        found = compiler()
        if found is None:
            raise FileNotFoundError("there is no C compiler here: neither cc nor gcc is on the path")
        self._folder = tempfile.TemporaryDirectory(prefix="bike_header_")
        folder, p = Path(self._folder.name), header.prefix
        (folder / "policy.h").write_text(header.text, encoding="utf-8")
        (folder / "policy.c").write_text(_SOURCE.replace("PREFIX", p) + (_NAMED.replace("PREFIX", p) * header.named))
        words = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC", "-o"]
        done = subprocess.run(
            [found, *words, str(folder / "policy.so"), str(folder / "policy.c"), "-lm"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            raise ValueError(f"the header does not compile with {found}: {done.stderr[:300]}")
        self._library = ctypes.CDLL(str(folder / "policy.so"))
        self._fields = len(header.fields)

    def act(self, observations: NDArray[np.float32], outputs: int) -> NDArray[np.float32]:
        """Return the actions of observations, shape (n, outputs)."""
        return self._all("act", observations, outputs)

    def answer(self, inputs: NDArray[np.float32], outputs: int) -> NDArray[np.float32]:
        """Return the commands of named inputs: the header's fields, x and y of the preview; shape (n, outputs)."""
        return self._all("answer", inputs, outputs)

    def _all(self, name: str, inputs: NDArray[np.float32], outputs: int) -> NDArray[np.float32]:
        inputs = np.ascontiguousarray(inputs, dtype=np.float32)
        out = np.zeros((len(inputs), outputs), dtype=np.float32)
        function = getattr(self._library, f"{name}_all")
        function.argtypes, function.restype = [_FLOATS, _FLOATS, *[ctypes.c_int] * 3], None
        function(inputs, out, len(inputs), inputs.shape[1], outputs)
        return out

    def answer_time(self, observations: NDArray[np.float32], outputs: int, rounds: int = 5) -> float:
        """Return the processor time of an action, s, of the best round."""
        return best_time(lambda: self.act(observations, outputs), rounds) / len(observations)


def best_time(work: Callable[[], Any], rounds: int) -> float:
    """Return the processor time of the best round of some work, s."""
    times = []
    for _ in range(rounds):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return min(times)


_SOURCE: Final = """#include "policy.h"

void act_all(const float *in, float *out, int count, int inputs, int outputs);
void act_all(const float *in, float *out, int count, int inputs, int outputs) {
  for (int i = 0; i < count; ++i) PREFIX_act(in + i * inputs, out + i * outputs);
}
"""
_NAMED: Final = """
void answer_all(const float *in, float *out, int count, int inputs, int outputs);
void answer_all(const float *in, float *out, int count, int inputs, int outputs) {
  for (int i = 0; i < count; ++i) PREFIX_answer((const PREFIX_inputs *)(in + i * inputs), out + i * outputs);
}
"""
