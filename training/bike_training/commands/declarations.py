"""All commands: their table of options, the subject of a call, and the function that does the work.

`commands.yaml` declares the options and the subjects that each applies to. Nothing heavy is loaded here, so that help
and refusals come at once: functions are loaded when they are called.
"""

from __future__ import annotations

import difflib
import re
from argparse import ArgumentParser, BooleanOptionalAction, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final, NoReturn

import yaml

from bike_sim.documents import show

_TABLE: Final[Mapping[str, Any]] = yaml.load(
    (resources.files("bike_training") / "commands" / "commands.yaml").read_text(encoding="utf-8"),
    getattr(yaml, "CSafeLoader", yaml.SafeLoader),  # compiled: this file is read before any help is shown
)
BICYCLE, SUPERBIKE, NODES, ALL, ATTACHED, REFINEMENT, RESUMED, CLASSICAL = _TABLE["subjects"][:8]
RECORDING, REPLAY, EXPLANATION, RUNS, SWEEP, CIRCUIT, TEMPLATE, PARAMETERS = _TABLE["subjects"][8:16]
RUN, REFINED, LEARNING, WORK, DATA, POLICY, TOPIC, BEST_LAP, BENCHMARK, VERIFICATION = _TABLE["subjects"][16:26]
RACE, DATASET = _TABLE["subjects"][26:]
"""Subjects of commands, as options name them; `WORK` is that of commands with one alone."""

DEFAULT_RIDER: Final = "default"
"""Stands for the rider that the policy node chooses by the vehicle."""
DEFAULT_BICYCLE: Final = "whipple"
DEFAULT_SUPERBIKE: Final = "panigale_v4r"
ALL_SUPERBIKES: Final = "superbikes"
"""Stands for the five shipped superbikes."""
EXACT: Final = "exact"
"""Preset that learns through the derivatives of the bicycle."""
OPTIMUM: Final = "optimum"
"""Preset that searches the best lap of a superbike."""
LARGEST_DOMAIN: Final = 232
"""ROS domain with the largest ports that there are."""


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        summary: one line.
        duration: how long it takes, in words.
        examples: text at the end of its help.
        functions: ``module:function`` that does the work, for each subject.
        subject: returns what parsed arguments are about.
        options: settings of each option by its flag, as in the table.
    """

    summary: str
    duration: str
    examples: str
    functions: Mapping[str, str]
    subject: Callable[[Namespace], str]
    options: Mapping[str, Mapping[str, Any]]


_TYPES: Final = {"int": int, "float": float, "path": Path}


class CommandParser(ArgumentParser):
    """Parser of a command whose options may apply to some of its subjects only (a bicycle, a superbike, ...).

    All options are None after parsing where they are not given. `resolve` refuses those that do not apply to the
    subject of a call, and sets the defaults of the others.

    Attributes:
        options: flag (name of a positional argument) and default for each subject that it applies to, of each option,
            by their attribute in the parsed arguments.
    """

    def __init__(self, name: str) -> None:
        """Take the options of a command from its name."""
        command = COMMANDS[name]
        super().__init__(
            prog=f"bike {name}",
            description=f"{command.summary[0].upper()}{command.summary[1:]}.",
            epilog=f"duration: {command.duration}\n\nexamples:\n{command.examples}",
            formatter_class=RawDescriptionHelpFormatter,
        )
        self.options: dict[str, tuple[str, dict[str, Any]]] = {}
        self.add_argument("--json", action="store_true", help="print one JSON object on standard output, nothing else")
        for flag, entries in command.options.items():
            self._add(flag, dict(entries), tuple(command.functions))

    def _add(self, flag: str, settings: dict[str, Any], subjects: Sequence[str]) -> None:
        """Add an option from its entries in the table; without subjects of its own it applies to all of them."""
        default, subjects = settings.pop("default", None), settings.pop("for", subjects)
        defaults = default if isinstance(default, Mapping) else dict.fromkeys(subjects, default)
        assert set(defaults) <= set(subjects), flag
        if settings.get("type") == "path":
            defaults = {subject: value and Path(value) for subject, value in defaults.items()}
        defaults = {subject: tuple(each) if isinstance(each, list) else each for subject, each in defaults.items()}
        if settings.get("action") == "store_true":
            defaults = {subject: bool(value) for subject, value in defaults.items()}
        words = {str(value): None for value in defaults.values() if value not in (None, False, ())}
        if words and "(default" not in settings["help"]:
            settings["help"] += f" (default: {' or '.join(words)})"
        settings["help"] = settings["help"].replace("{disturbances}", ", ".join(shipped("disturbances")))
        if "type" in settings:
            settings["type"] = _TYPES[settings["type"]]
        if settings.get("action") == "boolean":
            settings["action"] = BooleanOptionalAction
        self.options[self.add_argument(flag, default=None, **settings).dest] = flag, defaults

    def resolve(self, args: Namespace, subject: str) -> None:
        """Refuse given options that do not apply to a subject, and set the defaults of those that are not given.

        Raises:
            ValueError: an option does not apply.
        """
        for name, (flag, defaults) in self.options.items():
            if subject in defaults:
                if getattr(args, name) is None:
                    setattr(args, name, defaults[subject])
                if name == "rider" and args.rider == DEFAULT_RIDER:
                    args.rider = _default_rider(args.vehicle)
            elif getattr(args, name) is not None:
                raise ValueError(f"{flag} is for {', or '.join(defaults)}, and this is {subject}")

    def error(self, message: str) -> NoReturn:
        """Refuse the command line, with the option that may be meant.

        Raises:
            ValueError: always.
        """
        hint = f"see {self.prog} --help"
        wrong, _, names = message.partition(" (choose from ")
        known, word = re.findall(r"[\w-]+", names), wrong.rpartition(" ")[2].strip("'")
        if "unrecognized" in message:
            word = next((word for word in message.split() if word.startswith("--")), "").partition("=")[0]
            known = [flag for flag, *_ in self.options.values()]
        near = difflib.get_close_matches(word, known, 1)
        if near:
            hint = f"did you mean {near[0]}? See {self.prog} --help"
        raise ValueError(f"{message}; {hint}")


def shipped(folder: str) -> list[str]:
    """Return the names of the files in a folder of what is shipped with the simulator, sorted."""
    return sorted(
        entry.name.rpartition(".")[0] for entry in (resources.files("bike_sim") / "config" / folder).iterdir()
    )


def _vehicle_kind(vehicles: str) -> str:
    """Return the kind of a vehicle, or of the first of several with commas between them."""
    from bike_sim.vehicles.files import load_vehicle
    from bike_sim.vehicles.superbike import Superbike

    return SUPERBIKE if isinstance(load_vehicle(vehicles.split(",")[0]), Superbike) else BICYCLE


def _rider_kind(name: str) -> str:
    """Return the kind of vehicle that a rider rides."""
    from bike_policy.contract.bundle import load_bundle
    from bike_policy.riders.classical import SETTINGS
    from bike_policy.riders.rider import LAP_SUFFIX, RIDERS

    if name in RIDERS:
        return SUPERBIKE if name in (*SETTINGS, OPTIMUM) else BICYCLE
    if name.endswith(LAP_SUFFIX):
        return SUPERBIKE
    return SUPERBIKE if load_bundle(name, RIDERS).layout.races else BICYCLE


def _default_rider(vehicle: str) -> str:
    """Return the rider that rides a vehicle where none is chosen, the same as in the policy node."""
    from bike_policy.riders.rider import default_name
    from bike_sim.vehicles.files import load_vehicle

    return default_name(load_vehicle(vehicle))


def _course_kind(courses: str) -> str:
    """Return the kind of vehicle that rides a course by default: a superbike on circuits."""
    from bike_sim.course.files import kind_of

    return SUPERBIKE if kind_of(courses.split(",")[0]) == "circuit" else BICYCLE


def _choose_vehicle(args: Namespace, *riders: str | None, laps: bool = True) -> str:
    """Set the vehicle of a command where none is given, and return its kind; with `laps` superbikes need a circuit.

    It follows from the first rider, else from the course; without both it is the bicycle.
    """
    kinds = {rider: _rider_kind(rider) for rider in riders if rider not in (None, DEFAULT_RIDER)}
    if args.vehicle is None:
        kind = next(iter(kinds.values())) if kinds else _course_kind(args.course) if args.course else BICYCLE
        args.vehicle = DEFAULT_SUPERBIKE if kind == SUPERBIKE else DEFAULT_BICYCLE
    else:
        kind = _vehicle_kind(args.vehicle)
    for rider, ridden in kinds.items():
        if ridden != kind:
            raise ValueError(f"rider {show(rider)} is for {ridden}, and {show(args.vehicle)} is {kind}")
    if laps and kind == SUPERBIKE and args.course and _course_kind(args.course) == BICYCLE:
        raise ValueError(f"superbikes lap circuits, and course {show(args.course)} is a path")
    return kind


def _ride_subject(args: Namespace) -> str:
    if args.all:
        if args.nodes:
            raise ValueError("--nodes rides one machine on one circuit; leave --all out")
        return ALL
    kind = _choose_vehicle(args, args.rider, *(args.beside or () if args.nodes else ()))
    if args.nodes and kind == BICYCLE:
        raise ValueError(f"--nodes is for superbikes; {args.vehicle!r} is a bicycle, which always rides through nodes")
    return NODES if args.nodes else kind


def _live_subject(args: Namespace) -> str:
    if args.race:
        return RACE
    return ATTACHED if args.attach else _choose_vehicle(args, args.rider, laps=False)


def _race_subject(args: Namespace) -> str:
    args.machines = args.machines or None  # argparse has no None for none of several
    return REPLAY if args.replay else WORK


def _train_subject(args: Namespace) -> str:
    if args.resume:
        return RESUMED
    if args.preset == EXACT:
        if args.vehicle not in (None, DEFAULT_BICYCLE):
            raise ValueError(f"--preset {EXACT} refines riders of {DEFAULT_BICYCLE!r}, not of {args.vehicle!r}")
        return REFINEMENT
    if args.preset == OPTIMUM:
        args.vehicle = args.vehicle or DEFAULT_SUPERBIKE
        return BEST_LAP
    return _choose_vehicle(args)


def _export_subject(args: Namespace) -> str:
    from bike_policy.contract.bundle import CARD_FILE, shipped_policies
    from bike_training.learning.run_settings import GRADIENT_TABLE as TABLE

    if (args.run / CARD_FILE).is_file() or (str(args.run) in shipped_policies() and not args.run.exists()):
        if args.onnx is None and args.c is None and args.out is None:
            written = "--onnx FILE, --c FILE or --out DIR"
            raise ValueError(f"{args.run} is a policy already; say what to write of it: {written}")
        return POLICY
    return REFINED if (args.run / TABLE).is_file() else RUN


def _evaluate_subject(args: Namespace) -> str:
    from bike_policy.riders.rider import LAP_SUFFIX, RIDERS

    if args.verify is not None:
        return VERIFICATION
    if args.task is not None:
        return BENCHMARK
    if args.compare and args.rider is not None:
        raise ValueError("--compare names all riders that are evaluated; leave out the other")
    args.rider = None if args.rider == DEFAULT_RIDER else args.rider
    riders = args.compare or [args.rider]
    chosen = args.vehicle is not None
    kind = _choose_vehicle(args, *(riders if chosen or riders[0] is not None else [DEFAULT_BICYCLE]))
    if kind == BICYCLE:
        return BICYCLE
    if args.rider and (args.rider == OPTIMUM or args.rider.endswith(LAP_SUFFIX)):
        raise ValueError(f"{show(args.rider)} is one lap, ridden by `bike ride`; evaluated are riders from many starts")
    if not chosen:
        args.vehicle = None
    return CLASSICAL if args.rider in RIDERS else SUPERBIKE


def _validate_subject(args: Namespace) -> str:
    if args.template:
        return TEMPLATE
    if args.course is not None:
        return CIRCUIT
    if args.parameters is not None:
        return PARAMETERS
    if args.vehicle in (None, ALL_SUPERBIKES):
        return BICYCLE if args.vehicle is None else SUPERBIKE
    return _vehicle_kind(args.vehicle)


def _analyze_subject(args: Namespace) -> str:
    if args.replay or args.explain:
        if args.replay and args.explain:
            raise ValueError("--replay and --explain are two analyses; choose one")
        if len(args.objects) > 1:
            raise ValueError(
                f"{'--replay' if args.replay else '--explain'} takes one recording, got {len(args.objects)}"
            )
        return REPLAY if args.replay else EXPLANATION
    first: Path = args.objects[0]
    if args.minari is not None or args.lerobot is not None:
        return DATASET
    if args.topic is not None:
        if len(args.objects) > 1:
            raise ValueError(f"--topic takes one recording, got {len(args.objects)}")
        return TOPIC
    if any((first / name).is_file() for name in ("sweep.yaml", "runs.parquet")):
        if len(args.objects) > 1:
            raise ValueError(f"one sweep is reported at a time, got {len(args.objects)} objects")
        return SWEEP
    return RUNS if (first / "validations.csv").is_file() or (first / "run.json").is_file() else RECORDING


_SUBJECTS: Final[Mapping[str, Callable[[Namespace], str]]] = {
    "ride": _ride_subject,
    "live": _live_subject,
    "race": _race_subject,
    "train": _train_subject,
    "export": _export_subject,
    "evaluate": _evaluate_subject,
    "validate": _validate_subject,
    "analyze": _analyze_subject,
    "reproduce": lambda args: LEARNING if args.data is None else DATA,
}
"""Functions that return the subject of parsed arguments, of commands that have several."""

COMMANDS: Final[dict[str, Command]] = {
    name: Command(subject=_SUBJECTS.get(name, lambda args: WORK), **entries)
    for name, entries in _TABLE["commands"].items()
}
NEED_ROS: Final = frozenset(
    {
        ("ride", BICYCLE),
        ("ride", NODES),
        *((name, subject) for name in ("live", "race") for subject in COMMANDS[name].functions),
    }
)
"""Commands with subjects that ride or watch through nodes, or record messages."""
