"""An actor as an ONNX file.

The file is a message of Protocol Buffers (ONNX 1.12, ``onnx.proto3``). It has few enough fields to be written here, so
that nothing has to be installed for it; onnxruntime, where it is installed, reads it back.
"""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_policy.contract.bundle import Actor, Bundle
from bike_training.learning_packages import DISTRIBUTION

IR_VERSION: Final = 8
OPSET: Final = 17
LARGEST_DIFFERENCE: Final = 1e-6
"""Between an action of onnxruntime and the actor's; both compute in single precision, in another order."""
_FLOAT: Final = 1
"""`TensorProto.FLOAT`."""


def onnx_bytes(bundle: Bundle) -> bytes:
    """Return a policy's actor as ONNX: ``observation`` (n, inputs) to ``action`` (n, outputs) in [-1, 1].

    The names of the observation's numbers, the action's columns and the control period are the model's metadata.
    """
    graph, last = b"", "observation"
    for name, values in bundle.actor.tensors().items():
        graph += _field(5, _tensor(name, values))
    nodes = b""
    layers = len(bundle.actor.weights)
    for i in range(layers):
        nodes += _node("Gemm", (last, f"layers.{i}.weight", f"layers.{i}.bias"), f"sum.{i}", transB=1)
        last = f"hidden.{i}" if i < layers - 1 else "action"
        nodes += _node("Relu" if i < layers - 1 else "Tanh", (f"sum.{i}",), last)
    graph = nodes + _field(2, b"actor") + graph
    graph += _field(11, _value("observation", bundle.actor.inputs)) + _field(12, _value("action", bundle.actor.outputs))
    notes = {
        "policy": bundle.name,
        "vehicle": bundle.vehicle,
        "control_period_s": f"{bundle.control_period:g}",
        "decision_every_periods": str(bundle.layout.repeat),
        "observation": json.dumps(bundle.layout.names),
        "layout": json.dumps(bundle.layout.to_card()),
        "action": json.dumps(bundle.action.to_card()),
    }
    model = _field(1, IR_VERSION) + _field(2, DISTRIBUTION.encode()) + _field(3, version(DISTRIBUTION).encode())
    model += _field(7, graph) + _field(8, _field(2, OPSET))
    for key, value in notes.items():
        model += _field(14, _field(1, key.encode()) + _field(2, value.encode()))
    return model


def check_onnx(path: Path, actor: Actor, observations: NDArray[np.float32]) -> float:
    """Return the largest difference of a file's actions to the actor's.

    Args:
        path: of the file.
        actor: that it was made of.
        observations: shape (n, inputs).

    Raises:
        ModuleNotFoundError: onnxruntime is not installed.
        ValueError: a difference beyond `largest_difference`.
    """
    import onnxruntime

    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    (actions,) = session.run(["action"], {"observation": observations})
    difference = float(np.abs(actions - actor.act_batch(observations)).max())
    if not difference <= largest_difference(actor, observations):
        raise ValueError(f"{path}: onnxruntime's actions differ by {difference:.3g} from the actor's")
    return difference


def largest_difference(actor: Actor, observations: NDArray[np.float32]) -> float:
    """Return the largest difference that single precision may make.

    That is `LARGEST_DIFFERENCE`, or twice the error of the actor itself against double precision, once for each side:
    steep layers, or terms that cancel, lose more than that.
    """
    rounding = np.abs(actor.act_batch(observations) - actor.act_batch(observations.astype(np.float64))).max()
    return max(LARGEST_DIFFERENCE, 2.0 * float(rounding))


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _field(number: int, value: int | bytes) -> bytes:
    """Return a field: a whole number, or a string or message with its length."""
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    return _varint(number << 3 | 2) + _varint(len(value)) + value


def _tensor(name: str, values: NDArray[np.float32]) -> bytes:
    dims = b"".join(_field(1, size) for size in values.shape)
    return dims + _field(2, _FLOAT) + _field(8, name.encode()) + _field(9, values.astype("<f4").tobytes())


def _node(kind: str, inputs: tuple[str, ...], output: str, **attributes: int) -> bytes:
    node = b"".join(_field(1, name.encode()) for name in inputs) + _field(2, output.encode())
    node += _field(3, f"{kind}.{output}".encode()) + _field(4, kind.encode())
    for name, value in attributes.items():
        node += _field(5, _field(1, name.encode()) + _field(3, value) + _field(20, 2))  # 2: AttributeProto.INT
    return _field(1, node)


def _value(name: str, size: int) -> bytes:
    shape = _field(1, _field(2, b"n")) + _field(1, _field(1, size))
    return _field(1, name.encode()) + _field(2, _field(1, _field(1, _FLOAT) + _field(2, shape)))
