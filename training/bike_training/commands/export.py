"""`bike export`: make a policy bundle of a run, and files of a policy that other machines run."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from safetensors.numpy import load_file

from bike_policy.contract.action import STEERING_SET_VALUE, ActionLayout
from bike_policy.contract.bundle import Actor, Bundle, load_bundle
from bike_policy.contract.observation import ObservationLayout
from bike_sim.vehicles.files import load_vehicle
from bike_training.arguments import check_positive, read_json
from bike_training.curricula.parts import SPEED_RANGES
from bike_training.exporting.c_header import MICROCONTROLLER_HZ, CompiledHeader, compiler, make_header, rounded
from bike_training.exporting.observations import observations_of
from bike_training.exporting.onnx_file import check_onnx, onnx_bytes
from bike_training.learning.checkpoint import Checkpoint
from bike_training.learning.presets import Preset
from bike_training.learning.progress import chosen_actor
from bike_training.learning.run_settings import GRADIENT_POLICY, IMITATED, machines_of

SCHEMA: Final = "bike.export/1"


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Write the bundle."""
    checkpoint = Checkpoint(args.run)
    summary = read_json(args.run / "run.json", ("vehicle", "preset", "steps"))
    with checkpoint.reading():
        preset = Preset.from_plain(summary["preset"])
        wanted = args.which or ("success" if preset.published else "best")
        actor, which, step = chosen_actor(checkpoint.run["progress"], wanted, summary["steps"])
        if actor is None and args.which is None:
            print(f"there is no {wanted!r} actor yet, so this is the last one", file=sys.stderr)
            actor, which, step = chosen_actor(checkpoint.run["progress"], "last", summary["steps"])
    imitated = args.run / IMITATED
    if imitated.is_file() and (args.which == "imitated" or (actor is None and args.which is None)):
        print("this is the actor with which learning begins", file=sys.stderr)
        actor, which, step = Actor.from_tensors(load_file(imitated)), "imitated", 0
    elif args.which == "imitated":
        actor, which = None, "imitated"
    if actor is None:
        advice = "" if which in ("last", "imitated") else ", or export --which last"
        raise ValueError(f"{args.run}: there is no {which!r} actor yet; train longer{advice}")
    if args.symmetric:
        actor = _odd_part(actor, preset.deployed_layout)
    vehicle = load_vehicle(machines_of(summary["vehicle"])[0])
    task = preset.task
    parts, layout = _parts(args.range, task.action.size), preset.deployed_layout
    if args.share is not None:
        check_positive("--share", args.share, "")
        layout = replace(layout, share=args.share)
    bundle = Bundle(
        name=args.name or vehicle.name,
        actor=actor,
        layout=layout,
        action=_held(task.action.narrowed(parts), args.within),
        vehicle=vehicle.name,
        control_period=vehicle.control_period,
        training={
            **({} if task.layout.races else {"speed_range_m_s": list(SPEED_RANGES[-1])}),
            **summary,
            "actor": which,
            "actor_step": step,
            "range": parts,
            **({"symmetric": True} if args.symmetric else {}),
            "exported": time.strftime("%Y-%m-%d"),
        },
        results=_results(args.evaluation),
    )
    return _save(args, bundle, "policy", {"steps": summary["steps"], "actor": which, "actor_step": step})


def _odd_part(actor: Actor, layout: ObservationLayout) -> Actor:
    """Return half the difference of an actor's answers to an observation and to the mirrored one, as an actor.

    Raises:
        ValueError: a policy of races, whose actions do not all change signs.
    """
    if layout.races:
        raise ValueError("--symmetric is for policies of bicycles: in a mirrored race the throttle keeps its sign")
    import jax.numpy as jnp  # late: it takes seconds

    from bike_training.learning.gradients import MirrorSymmetricActor

    weights = [(jnp.asarray(w), jnp.asarray(b)) for w, b in zip(actor.weights, actor.biases, strict=True)]
    return MirrorSymmetricActor(layout).folded(weights)


def run_refined(args: argparse.Namespace) -> dict[str, Any]:
    """Write the bundle of a refinement, which holds its best actor already, with name and results."""
    found = load_bundle(args.run / GRADIENT_POLICY)
    training = {**found.training, "exported": time.strftime("%Y-%m-%d")}
    bundle = replace(
        found,
        name=args.name or found.name,
        action=_held(found.action, args.within),
        training=training,
        results=_results(args.evaluation),
    )
    figures = {"steps": training["steps"], "actor": "best", "actor_step": training["best_segment"]}
    return _save(args, bundle, GRADIENT_POLICY, figures)


def run_policy(args: argparse.Namespace) -> dict[str, Any]:
    """Write files of a policy, and the policy with the weights of its header as a bundle."""
    bundle = load_bundle(args.run)
    figures: dict[str, Any] = {"name": bundle.name}
    if args.out is not None:
        written = bundle
        if args.weights == "int8":  # the card's results are of the other weights
            training = {**bundle.training, "weights": args.weights}
            written = replace(bundle, actor=rounded(bundle.actor)[2], training=training, results={})
        written.save(args.out)
        figures["out"] = str(args.out)
        if not args.json:
            print(f"policy {bundle.name} with {args.weights} weights written to {args.out}")
    return {"schema": SCHEMA, "ok": True, "figures": {**figures, **_write_files(args, bundle)}}


def _write_files(args: argparse.Namespace, bundle: Bundle) -> dict[str, Any]:
    """Write the files of a policy that are asked for, check them, and return the figures of that."""
    if args.onnx is None and args.c is None:
        return {}
    for path in (args.onnx, args.c):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
    observations, where = observations_of(bundle, args.recording)
    figures: dict[str, Any] = {"compared_on": where, "observations": len(observations)}
    lines = []
    if args.onnx is not None:
        args.onnx.write_bytes(onnx_bytes(bundle))
        try:
            difference: float | None = check_onnx(args.onnx, bundle.actor, observations)
            lines.append(f"{args.onnx}: onnxruntime's actions differ by {difference:.2g} at most from the actor's")
        except ModuleNotFoundError:
            difference = None
            print(
                f"{args.onnx} is not checked: onnxruntime is not installed (pip install onnxruntime)", file=sys.stderr
            )
        figures |= {"onnx": str(args.onnx), "onnx_difference": difference}
    if args.c is not None:
        header = make_header(bundle, args.weights, observations, where)
        args.c.write_text(header.text, encoding="utf-8")
        compiled: dict[str, float] = {}
        if compiler() is None:
            print(f"{args.c} is not checked: there is no C compiler here", file=sys.stderr)
        else:
            library = CompiledHeader(header)
            answers = library.act(observations, bundle.action.size)
            compiled["difference"] = float(np.abs(answers - bundle.actor.act_batch(observations)).max())
            compiled["answer_us"] = 1e6 * library.answer_time(observations, bundle.action.size)
            text = f"{compiled['difference']:.2g} at most from the actor's; {compiled['answer_us']:.1f} µs each"
            lines.append(f"{args.c}: compiled here, its actions differ by {text}")
        header_figures = {
            "file": str(args.c),
            "weights": args.weights,
            "named_inputs": header.named,
            "rounding_max": header.error,
            "rounding_rms": header.error_rms,
            "multiply_adds": header.multiply_adds,
            "cortex_m4_cycles": header.cycles,
            "cortex_m4_ms": 1e3 * header.cycles / MICROCONTROLLER_HZ,
            "weight_bytes": header.bytes,
            **compiled,
        }
        figures["headers"] = [header_figures]
    if not args.json:
        print("\n".join([*lines, f"compared on {len(observations)} observations of {where}"]))
    return figures


def _save(args: argparse.Namespace, bundle: Bundle, folder: str, figures: dict[str, Any]) -> dict[str, Any]:
    """Write a bundle, by default into a folder of its run, and return the figures of the command."""
    out = args.out or args.run / folder
    bundle.save(out)
    if not args.json:
        print(f"policy {bundle.name} written to {out}: the {figures['actor']!r} actor, of step {figures['actor_step']}")
    figures = {"out": str(out), "name": bundle.name, **figures, **_write_files(args, bundle)}
    return {"schema": SCHEMA, "ok": True, "figures": figures}


def _parts(text: str | None, count: int) -> list[float]:
    """Return the part of its range that each action keeps.

    Raises:
        ValueError: the text is no such list.
    """
    if text is None:
        return [1.0] * count
    try:
        parts = [float(word) for word in text.split(",")]
    except ValueError:
        parts = []
    if len(parts) != count or not all(0.0 < part <= 1.0 for part in parts):
        raise ValueError(
            f"--range {text}: needs a part above 0 and up to 1 for each action of the policy, which has {count}"
        )
    return parts


def _held(action: ActionLayout, text: str | None) -> ActionLayout:
    """Return an action whose set point is held within limits that depend on the speed.

    Raises:
        ValueError: the text holds no such limits, or the policy does more than steer.
    """
    if text is None:
        return action
    if action.names != (STEERING_SET_VALUE,):
        raise ValueError(
            f"--within {text}: limits by speed are of a bicycle's steering, this policy gives {action.names}"
        )
    try:
        pairs = [tuple(float(number) for number in word.split(":")) for word in text.split(",")]
        if any(len(pair) != 2 for pair in pairs):
            raise ValueError("each limit needs a speed and a value")
        return ActionLayout.steering(action.columns[0].scale, tuple((speed, limit) for speed, limit in pairs))
    except ValueError as error:
        raise ValueError(f"--within {text}: {error}; wanted are pairs as 3:1.2,4.5:0.8") from error


def _results(path: Path | None) -> dict[str, Any]:
    if path is None:
        return {}
    figures = read_json(path)
    if "races" in figures:
        return {
            f"{race['circuit']}_{race['vehicle']}_{name}": value
            for race in figures["races"]
            for name, value in race.items()
            if name not in ("circuit", "vehicle")
        }
    return {key: value for key, value in figures.items() if not isinstance(value, list)}
