"""All commands with their options, the subjects that each option applies to, and the function that does the work.

Nothing heavy is loaded here, so that help and refusals come at once: functions are loaded when they are called.
"""

from __future__ import annotations

from argparse import BooleanOptionalAction, Namespace
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from bike_sim.documents import show
from bike_training.arguments import CommandParser

BICYCLE: Final = "a bicycle"
SUPERBIKE: Final = "a superbike"
NODES: Final = "a superbike through nodes (--nodes)"
ALL: Final = "all superbikes on all circuits (--all)"
ATTACHED: Final = "a simulator that runs already (--attach)"
REFINEMENT: Final = "a bicycle with --preset exact"
RESUMED: Final = "a resumed run (--resume)"
CLASSICAL: Final = "a superbike's rider that is not learned"
RECORDING: Final = "a recording"
REPLAY: Final = "a replay (--replay)"
EXPLANATION: Final = "an explanation (--explain)"
RUNS: Final = "folders of runs"
SWEEP: Final = "the folder of a sweep"
CIRCUIT: Final = "a circuit (--course)"
TEMPLATE: Final = "a vehicle's file (--template)"
RUN: Final = "a run"
REFINED: Final = "a refined run"
LEARNING: Final = "learning"
WORK: Final = "its work"
"""The subject of commands that have one alone."""
DATA: Final = "drawing again (--data)"

DEFAULT_BICYCLE: Final = "whipple"
DEFAULT_SUPERBIKE: Final = "panigale_v4r"
ALL_SUPERBIKES: Final = "superbikes"
"""Stands for the five shipped superbikes."""
EXACT: Final = "exact"
"""Preset that learns through the derivatives of the bicycle."""
LARGEST_DOMAIN: Final = 232
"""ROS domain with the largest ports that there are."""
ENGINES: Final = ("pybullet", "whipple", "compiled")


RENAMED: Final = {
    "lap": "bike ride --course barcelona, with --vehicle and --rider",
    "refine": "bike train --preset exact",
    "replay": "bike analyze RECORDING --replay",
    "explain": "bike analyze RECORDING --explain",
    "course": "bike validate --course CIRCUIT, with --out for a picture",
    "report": "bike analyze SWEEP",
    "curves": "bike analyze RUN ...",
}
"""Commands of earlier versions, and what does their work."""

RENAMED_OPTIONS: Final = {
    ("ride", "--policy"): "--rider",
    ("evaluate", "--rider"): "the name alone",
    ("evaluate", "--superbike"): "--vehicle, or nothing where the policy races",
    ("evaluate", "--machines"): "--vehicle",
    ("evaluate", "--circuits"): "--course",
    ("train", "--vehicle"): "bike train VEHICLE",
    ("train", "--circuit"): "--course",
    ("analyze", "--vehicle"): "--namespace",
}
"""Options of earlier versions by command, and what stands for them."""


@dataclass(frozen=True)
class Command:
    """A command.

    Attributes:
        summary: one line.
        duration: how long it takes, in words.
        examples: text at the end of its help.
        declare: declares its options.
        subject: returns what parsed arguments are about.
        functions: ``module:function`` that does the work, for each subject.
    """

    summary: str
    duration: str
    examples: str
    declare: Callable[[CommandParser], None]
    subject: Callable[[Namespace], str]
    functions: Mapping[str, str]

    def parser(self, name: str) -> CommandParser:
        """Return the parser of its arguments, under the name of the command."""
        parser = CommandParser(name, self.summary, tuple(self.functions), RENAMED_OPTIONS)
        parser.epilog = f"duration: {self.duration}\n\nexamples:\n{self.examples.rstrip()}"
        self.declare(parser)
        return parser


def shipped(folder: str) -> list[str]:
    """Return the names of the files in a folder of what is shipped with the simulator, sorted."""
    return sorted(
        entry.name.rpartition(".")[0] for entry in (resources.files("bike_sim") / "config" / folder).iterdir()
    )


# ---------------------------------------- which kind of vehicle


def vehicle_kind(vehicles: str) -> str:
    """Return the kind of a vehicle, or of the first of several with commas between them.

    Raises:
        FileNotFoundError, ValueError: an unknown vehicle, or a broken file.
    """
    from bike_sim.vehicles.files import load_vehicle
    from bike_sim.vehicles.superbike import Superbike

    return SUPERBIKE if isinstance(load_vehicle(vehicles.split(",")[0]), Superbike) else BICYCLE


def rider_kind(name: str) -> str:
    """Return the kind of vehicle that a rider rides.

    Raises:
        FileNotFoundError, ValueError: an unknown rider, or a broken bundle.
    """
    from bike_policy.contract.bundle import load_bundle
    from bike_policy.riders.classical import CLASSICAL as CLASSICAL_RIDER
    from bike_policy.riders.rider import RIDERS

    if name in RIDERS:
        return SUPERBIKE if name == CLASSICAL_RIDER else BICYCLE
    return SUPERBIKE if load_bundle(name, RIDERS).layout.races else BICYCLE


def course_kind(courses: str) -> str:
    """Return the kind of vehicle that rides a course by default: a superbike on circuits.

    Raises:
        FileNotFoundError, ValueError: an unknown course, or a broken file.
    """
    from bike_sim.course.files import kind_of

    return SUPERBIKE if kind_of(courses.split(",")[0]) == "circuit" else BICYCLE


def choose_vehicle(args: Namespace, *riders: str | None, laps: bool = True) -> str:
    """Set the vehicle of a command where none is given, and return its kind.

    It follows from the first rider, else from the course; without both it is the bicycle.

    Args:
        args: arguments with vehicle and course.
        riders: names or folders; None where there is none.
        laps: whether superbikes need a circuit.

    Raises:
        ValueError: a rider of another kind of vehicle, or a superbike on a path.
    """
    kinds = {rider: rider_kind(rider) for rider in riders if rider is not None}
    if args.vehicle is None:
        kind = next(iter(kinds.values())) if kinds else course_kind(args.course) if args.course else BICYCLE
        args.vehicle = DEFAULT_SUPERBIKE if kind == SUPERBIKE else DEFAULT_BICYCLE
    else:
        kind = vehicle_kind(args.vehicle)
    for rider, ridden in kinds.items():
        if ridden != kind:
            raise ValueError(f"rider {show(rider)} is for {ridden}, and {show(args.vehicle)} is {kind}")
    if laps and kind == SUPERBIKE and args.course and course_kind(args.course) == BICYCLE:
        raise ValueError(f"superbikes lap circuits, and course {show(args.course)} is a path")
    return kind


# ---------------------------------------- ride and live


def _declare_recording(parser: CommandParser, usual: Mapping[str, str]) -> None:
    """Declare where a recording goes.

    Args:
        parser: of the command.
        usual: name of the folder by subject.
    """
    folders = " or ".join(f"out/{name}" for name in dict.fromkeys(usual.values()))
    text = f"folder of recording and report (default: {folders}, with a number where that holds a recording)"
    parser.option("--out", only=tuple(usual), type=Path, help=text)
    parser.option("--overwrite", only=tuple(usual), action="store_true", help="replace a recording that it holds")


def _declare_ride(parser: CommandParser) -> None:
    one = (BICYCLE, SUPERBIKE, NODES)
    laps = (SUPERBIKE, NODES, ALL)
    parser.option(
        "--vehicle",
        only=one,
        help=f"name or file of a vehicle (default: the rider's kind; {DEFAULT_SUPERBIKE} on circuits, else whipple)",
    )
    circuits = {SUPERBIKE: "barcelona", NODES: "barcelona"}
    parser.option("--course", default={BICYCLE: "benchmark", **circuits}, help="path or circuit, by name or file")
    riders = {BICYCLE: "whipple", **dict.fromkeys(laps, "classical")}
    parser.option("--rider", default=riders, help="name or folder of a policy, or a rider that is not learned")
    engines = {BICYCLE: "pybullet", SUPERBIKE: "pybullet", ALL: "pybullet"}
    parser.option("--engine", choices=ENGINES, default=engines, help="whipple: a bicycle; compiled: superbikes")
    _declare_recording(parser, {BICYCLE: "ride", NODES: "lap"})
    parser.option("--speed", type=float, default={BICYCLE: 4.0}, help="forward speed of a bicycle, m/s")
    parser.option("--time-step", type=float, default={BICYCLE: 0.001}, help="integration step of a bicycle, s")
    disturbances = ", ".join(shipped("disturbances"))
    parser.option(
        "--disturbances", only=BICYCLE, metavar="FILE", help=f"a YAML file, or {disturbances}; a bicycle's; recorded"
    )
    parser.option(
        "--real-time", only=BICYCLE, action="store_true", help="at the pace of the clock, not as fast as it goes"
    )
    parser.option(
        "--domain", only=BICYCLE, type=int, help="ROS domain (default: a free one, so that rides do not meet)"
    )
    parser.option("--laps", type=int, default=dict.fromkeys(laps, 3), help="flying laps of a superbike")
    parser.option(
        "--nodes",
        only=NODES,
        action="store_true",
        help="a superbike through simulator, policy and recorder nodes, with recording and report, as bicycles are",
    )
    parser.option(
        "--beside", only=NODES, metavar="RIDER", help="who laps as well, to be compared by arc length in ride.html"
    )
    parser.option("--all", only=ALL, action="store_true", help="all shipped superbikes on all shipped circuits")


def _ride_subject(args: Namespace) -> str:
    if args.all:
        if args.nodes:
            raise ValueError("--nodes rides one machine on one circuit; leave --all out")
        return ALL
    kind = choose_vehicle(args, args.rider, args.beside if args.nodes else None)
    if args.nodes and kind == BICYCLE:
        raise ValueError(f"--nodes is for superbikes; {args.vehicle!r} is a bicycle, which always rides through nodes")
    return NODES if args.nodes else kind


_RIDE: Final = Command(
    "ride a course, record it and report; lap a circuit on a superbike",
    "less than a minute on a path, a minute or two for laps, much longer for --all; the first start compiles",
    """\
  bike ride                                      the benchmark path at 4 m/s with the shipped policy
  bike ride --speed 6.5 --course circle --out out/circle
  bike ride --disturbances wind                  in the wind, which the recording keeps for bike analyze --replay
  bike ride --real-time                          at the pace of the clock, to watch it in Foxglove or RViz
  bike ride --course barcelona                   the Panigale V4 R, three flying laps beside the theoretical ones
  bike ride --vehicle r1 --course monza.csv --laps 1   a circuit from a CSV file
  bike ride --course barcelona --rider racer     a learned rider; also runs/r/policy
  bike ride --course barcelona --nodes --rider racer --beside classical   both recorded, and where each is faster
  bike ride --all --json                         all superbikes on all circuits, as one JSON object

A bicycle rides through simulator, policy and recorder nodes; superbikes do with --nodes. The first lap, from a rolling
start, is not counted. Lines once computed are kept in $BIKE_CACHE, else ~/.cache/bike.""",
    _declare_ride,
    _ride_subject,
    {
        BICYCLE: "ride:run",
        SUPERBIKE: "ride:run_laps",
        NODES: "ride:run_through_nodes",
        ALL: "ride:run_laps",
    },
)


def _declare_live(parser: CommandParser) -> None:
    own = (BICYCLE, SUPERBIKE)
    parser.option("--vehicle", only=own, help="name or file of a vehicle (default: the rider's kind, or whipple)")
    courses = {BICYCLE: "benchmark", SUPERBIKE: "barcelona"}
    parser.option("--course", default=courses, help="path or circuit, by name or file")
    riders = {BICYCLE: "whipple", SUPERBIKE: "classical"}
    parser.option("--rider", default=riders, help="the computer's rider: a policy, or one that is not learned")
    parser.option("--speed", type=float, default={BICYCLE: 4.0}, help="of a bicycle, m/s")
    parser.option("--port", type=int, default=0, help="port of the page (default: a free one)")
    parser.option(
        "--foxglove",
        type=int,
        nargs="?",
        const=8765,  # which Foxglove's app offers when a connection is opened
        metavar="PORT",
        help="serve the ride's topics to Foxglove's app as well (default port: %(const)s; 0: a free one)",
    )
    parser.option("--attach", only=ATTACHED, action="store_true", help="watch a simulator that others ride")
    parser.option("--domain", only=ATTACHED, type=int, help="its ROS domain (default: ROS_DOMAIN_ID, or 0)")
    parser.option("--namespace", only=ATTACHED, help="of its topics (default: bike)")
    parser.option("--seconds", type=float, help="end after this wall-clock time (default: at Ctrl-C)")
    parser.option(
        "--against",
        only=own,
        type=Path,
        nargs="*",
        default=(),
        help="recordings: a ghost now, a comparison at the end",
    )
    _declare_recording(parser, dict.fromkeys(own, "live"))


_LIVE: Final = Command(
    "ride in a browser: watch, steer, and compare with other riders",
    "some seconds until the page is there",
    """\
  bike live                                               the bicycle on the benchmark path; open the address it prints
  bike live --vehicle panigale_v4r --course barcelona     a superbike; arrows, touch or a gamepad ride it
  bike live --course circle --against out/ride/ride.mcap  beside another recording in the report at the end
  bike live --foxglove                                    its topics for Foxglove's app as well, at ws://127.0.0.1:8765
  bike live --attach --domain 7                           watch the simulator that runs in that ROS domain

The page is served at 127.0.0.1 only, and its address has a token. Ctrl-C ends the ride and writes the report.""",
    _declare_live,
    lambda args: ATTACHED if args.attach else choose_vehicle(args, args.rider, laps=False),
    {BICYCLE: "live:run", SUPERBIKE: "live:run", ATTACHED: "live:watch"},
)

# ---------------------------------------- train and export


def _declare_train(parser: CommandParser) -> None:
    new = (BICYCLE, SUPERBIKE)
    learned = (*new, RESUMED)
    parser.option(
        "vehicle",
        nargs="?",
        help="vehicle to train, by name or file; superbikes with commas between them for one actor of several machines "
        f"(default: {DEFAULT_BICYCLE}; of a resumed run its own)",
    )
    parser.option(
        "--course", only=SUPERBIKE, help="circuits by name or file, with commas between them (default: the preset's)"
    )
    parser.option("--curriculum", only=SUPERBIKE, help="of superbikes: none, speed or spdl (default: the preset's)")
    parser.option("--out", type=Path, required=True, help="folder of the run")
    parser.option(
        "--preset",
        only=(*new, REFINEMENT),
        help=f"settings, by name: fast, paper, ... (default: fast, on superbikes race), or {EXACT}: through the "
        "derivatives of the bicycle",
    )
    parser.option(
        "--set",
        only=(*new, REFINEMENT),
        action="append",
        metavar="NAME=VALUE",
        help="change one setting of the preset",
    )
    parser.option("--from", only=REFINEMENT, dest="start", help=f"policy that {EXACT} begins with (default: none)")
    parser.option("--client", only=learned, choices=("local", "ros"), help="where the simulator is (default: local)")
    parser.option(
        "--engine",
        only=learned,
        choices=ENGINES,
        help="default: whipple locally, pybullet through ROS; of superbikes compiled",
    )
    parser.option(
        "--time-step",
        only=learned,
        type=float,
        help="integration step of simulators, s (default: 0.005); not of the compiled engine",
    )
    parser.option(
        "--simulators",
        only=learned,
        type=int,
        help="simulators side by side where they are not compiled into this process (default: 2, or fewer where the "
        "preset rides fewer); the updates for each step of learning stay the preset's",
    )
    parser.option("--seed", only=(*new, REFINEMENT), type=int, help="seed of everything (default: 0)")
    parser.option("--steps", only=learned, type=int, help="learning steps in all (default: those of the preset)")
    parser.option(
        "--until-finished",
        only=learned,
        action=BooleanOptionalAction,
        help="stop when the curriculum is finished",
    )
    parser.option("--resume", only=RESUMED, action="store_true", help="go on from the checkpoint in --out")
    parser.option("--checkpoint-every", only=learned, type=int, help="learning steps between checkpoints")
    parser.option(
        "--record-every",
        only=learned,
        type=int,
        help="validations between recorded rides; 0 records none (default: 10)",
    )


def _train_subject(args: Namespace) -> str:
    if args.resume:
        return RESUMED
    if args.preset == EXACT:
        if args.vehicle not in (None, DEFAULT_BICYCLE):
            raise ValueError(f"--preset {EXACT} refines riders of {DEFAULT_BICYCLE!r}, not of {args.vehicle!r}")
        return REFINEMENT
    return choose_vehicle(args)


_TRAIN: Final = Command(
    "learn to ride",
    "minutes for a bicycle with --until-finished, an hour or more for all steps of its preset; superbikes take hours",
    f"""\
  bike train whipple --out runs/a                        the default preset on the compiled engine
  bike train whipple --out runs/b --client ros           through ROS, with PyBullet behind it
  bike train whipple --out runs/c --preset paper         as published
  bike train whipple --out runs/e --preset {EXACT}         through the derivatives of the bicycle, from nothing
  bike train whipple --out runs/f --preset {EXACT} --from runs/e/policy --set learner.segments=200
  bike train --out runs/a --resume --steps 2000000
  bike train --out runs/a --resume --steps 2050000 --client ros   the last steps through ROS
  bike train whipple --out runs/d --set learner.layers=128,128 --set learner.gamma=0.98
  bike train panigale_v4r --out runs/r --course cremona --seed 3            races; the default preset
  bike train panigale_v4r --out runs/s --preset paper --curriculum spdl     as published, on our circuits
  bike train r1 --out runs/x --course barcelona,cremona
  bike train r1,zx10rr --out runs/m --set task.observation=conditioned                  one actor for two machines""",
    _declare_train,
    _train_subject,
    {BICYCLE: "train:run", SUPERBIKE: "train:run", RESUMED: "train:run", REFINEMENT: "train:run_refinement"},
)


def _declare_export(parser: CommandParser) -> None:
    parser.option("run", type=Path, help="folder of a run of bike train")
    parser.option("--name", help="name of the policy (default: that of the vehicle)")
    parser.option("--out", type=Path, help="folder of the bundle (default: RUN/policy)")
    parser.option(
        "--which",
        only=RUN,
        choices=("best", "success", "last"),
        help="the best on the rides that actors are compared on (success where none was compared yet), the most recent "
        "one that passed every ride of a validation (as the paper does), or the last one (default: success for the "
        "paper's presets, else best; the last while there is none)",
    )
    parser.option(
        "--range",
        only=RUN,
        help="parts of the range of each action that the policy keeps, as 0.5,0.7: less of line and pace of a race are "
        "slower and safer than what it learned with (default: all)",
    )
    parser.option(
        "--within",
        help="pairs of a speed (m/s) and the largest value of a bicycle's steering set point there (rad), as "
        "3:1.2,4.5:0.8; linear between them, constant beyond them (default: no limit but the action's)",
    )
    parser.option("--evaluation", type=Path, help="evaluation.json whose summary goes into the card")


def _export_subject(args: Namespace) -> str:
    from bike_training.learning.run_settings import GRADIENT_TABLE as TABLE

    return REFINED if (args.run / TABLE).is_file() else RUN


_EXPORT: Final = Command(
    "make a policy bundle of a run",
    "seconds",
    "  bike export runs/a --name mine && bike evaluate runs/a/policy",
    _declare_export,
    _export_subject,
    {RUN: "export:run", REFINED: "export:run_refined"},
)

# ---------------------------------------- evaluate and validate


def _declare_evaluate(parser: CommandParser) -> None:
    races = (SUPERBIKE, CLASSICAL)
    parser.option(
        "rider", nargs="?", help="policy by name or folder, or lqr, mpc, stanley, classical (default: whipple)"
    )
    parser.option(
        "--vehicle",
        help=f"name or file; superbikes with commas between them (default: the rider's kind; {DEFAULT_SUPERBIKE}, all "
        "with --tables)",
    )
    parser.option(
        "--course",
        default={BICYCLE: "benchmark", **dict.fromkeys(races)},
        help="path; of superbikes circuits with commas between them (default: benchmark, barcelona; all with --tables)",
    )
    folders = {BICYCLE: Path("out/evaluate"), **dict.fromkeys(races, Path("out/evaluate"))}
    parser.option("--out", type=Path, default=folders, help="folder of evaluation.json or races.json")
    parser.option(
        "--compare", only=BICYCLE, nargs="+", metavar="RIDER", help="several riders of bicycles, in one table"
    )
    parser.option(
        "--disturbances",
        nargs="+",
        default={BICYCLE: ()},
        metavar="FILE",
        help=f"ride the path again under each: a YAML file, or {', '.join(shipped('disturbances'))}; of bicycles",
    )
    parser.option(
        "--client",
        choices=("local", "ros", "nodes"),
        default={BICYCLE: "local"},
        help="of bicycles; local: in this process; ros: simulator node, policy here; nodes: simulator and policy node",
    )
    parser.option("--engine", choices=ENGINES[:2], default={BICYCLE: "pybullet"}, help="of bicycles")
    parser.option("--time-step", type=float, default={BICYCLE: 0.001}, help="integration step of a bicycle, s")
    parser.option("--speeds", type=float, nargs="+", only=BICYCLE, help="of bicycles, m/s (default: 2 to 7 by 0.25)")
    parser.option(
        "--random-rides", type=int, default={BICYCLE: 1}, help="30 s rides of bicycles on random paths at each speed"
    )
    parser.option("--seed", type=int, default={BICYCLE: 0}, help="seed of the random paths")
    parser.option("--starts", type=int, default={SUPERBIKE: 100, CLASSICAL: 4}, help="rides of each superbike")
    parser.option("--laps", type=int, default=dict.fromkeys(races, 1), help="flying laps of each ride")
    parser.option(
        "--in-turn", only=races, action="store_true", help="one superbike on each circuit, in turn, not each on each"
    )
    parser.option(
        "--tables",
        only=SUPERBIKE,
        action="store_true",
        help="Tables I to III of the superbike paper, and write tables.md",
    )
    parser.option(
        "--share", only=SUPERBIKE, type=float, help="part of the planned speed that is asked (default: the policy's)"
    )


def _evaluate_subject(args: Namespace) -> str:
    from bike_policy.riders.rider import RIDERS

    if args.compare and args.rider is not None:
        raise ValueError("--compare names all riders that are evaluated; leave out the other")
    riders = args.compare or [args.rider]
    chosen = args.vehicle is not None
    kind = choose_vehicle(args, *(riders if chosen or riders[0] is not None else [DEFAULT_BICYCLE]))
    if kind == BICYCLE:
        return BICYCLE
    if not chosen:
        args.vehicle = None
    return CLASSICAL if args.rider in RIDERS else SUPERBIKE


_EVALUATE: Final = Command(
    "ride a policy at 21 speeds, or laps of superbikes, and write down how well",
    "a minute or two for 21 speeds or a hundred starts, so long for each of --compare and each pair of --tables",
    """\
  bike evaluate                                the shipped policy, in process, PyBullet at 1 ms
  bike evaluate runs/a/policy --client nodes   through the simulator node and the policy node
  bike evaluate whipple --course junction --speeds 4
  bike evaluate mpc                            a rider that is not learned
  bike evaluate lqr --disturbances noise delay_50 mine.yaml
  bike evaluate --compare whipple lqr mpc stanley   side by side in one table
  bike evaluate racer --vehicle zx10rr --course cremona
  bike evaluate runs/r/policy --vehicle panigale_v4r,r1 --course barcelona,cremona
  bike evaluate racer --tables                 the superbike paper's Tables I to III
  bike evaluate classical --starts 2           the superbikes' rider that is not learned""",
    _declare_evaluate,
    _evaluate_subject,
    {BICYCLE: "evaluate:run", SUPERBIKE: "evaluate:run_races", CLASSICAL: "evaluate:run_races"},
)


def _declare_validate(parser: CommandParser) -> None:
    parser.option(
        "--vehicle",
        default={BICYCLE: DEFAULT_BICYCLE, SUPERBIKE: ALL_SUPERBIKES, TEMPLATE: DEFAULT_BICYCLE},
        help=f"vehicle by name or file, or `{ALL_SUPERBIKES}` for all five together (default: {DEFAULT_BICYCLE})",
    )
    parser.option("--engine", choices=ENGINES[:2], default={BICYCLE: "pybullet"}, help="of the bicycle")
    parser.option(
        "--time-step", type=float, metavar="S", default={BICYCLE: 0.001, SUPERBIKE: 0.002}, help="integration step, s"
    )
    parser.option("--course", only=CIRCUIT, metavar="CIRCUIT", help="check a circuit instead, by name or file")
    parser.option(
        "--lateral-g",
        type=float,
        metavar="G",
        default={CIRCUIT: 1.4},
        help="cornering of the circuit's reference machine",
    )
    parser.option(
        "--template", only=TEMPLATE, action="store_true", help="print a vehicle's file with all keys explained"
    )
    measured = (BICYCLE, SUPERBIKE, CIRCUIT)
    parser.option("--out", only=measured, type=Path, metavar="DIR", help="folder for pictures and figures")


def _validate_subject(args: Namespace) -> str:
    if args.template:
        return TEMPLATE
    if args.course is not None:
        return CIRCUIT
    if args.vehicle in (None, ALL_SUPERBIKES):
        return BICYCLE if args.vehicle is None else SUPERBIKE
    return vehicle_kind(args.vehicle)


_VALIDATE: Final = Command(
    "hold the physics against its publications, or check a circuit",
    "less than a minute; the five superbikes take minutes",
    f"""\
  bike validate                                   the benchmark bicycle in PyBullet at 1 ms
  bike validate --time-step 0.005 --out out       at 5 ms, with modes.png and validate.json in out/
  bike validate --engine whipple --json           the compiled bicycle, figures as JSON
  bike validate --vehicle {ALL_SUPERBIKES} --out out      five superbikes against statics and closed formulas
  bike validate --vehicle mine.yaml               a bicycle or a superbike of your own
  bike validate --course monza.csv                is the file a circuit? length, widths, corners, theoretical lap
  bike validate --template --vehicle r1 > mine.yaml   a file of your own to begin with: every key, unit and meaning
  bike validate --course barcelona --out pictures   also pictures/barcelona.png, the ideal line coloured by speed

A CSV file of a circuit has the columns x_m,y_m,w_tr_right_m,w_tr_left_m: centre line and distances to its limits.""",
    _declare_validate,
    _validate_subject,
    {
        BICYCLE: "validate:run",
        SUPERBIKE: "validate:run_superbikes",
        CIRCUIT: "validate:run_circuit",
        TEMPLATE: "validate:run_template",
    },
)

# ---------------------------------------- analyze


def _declare_analyze(parser: CommandParser) -> None:
    pictures = {
        RECORDING: None,
        EXPLANATION: Path("out/explain"),
        RUNS: Path("out/learning_curves.png"),
        SWEEP: None,
    }
    parser.option(
        "objects",
        type=Path,
        nargs="+",
        metavar="OBJECT",
        help="recordings (.mcap files or rosbag2 directories), folders of runs of bike train, or the folder of a sweep",
    )
    parser.option(
        "--out",
        type=Path,
        metavar="DIR",
        default=pictures,
        help="folder of pages and pictures (default: beside a recording; out/explain; out/learning_curves.png of runs; "
        "SWEEP/report)",
    )
    parser.option("--csv", only=RECORDING, type=Path, metavar="FILE", help="write rides or laps, aligned by arc length")
    parser.option("--parquet", only=RECORDING, type=Path, metavar="FILE", help="the same as Parquet")
    parser.option("--station", only=RECORDING, type=float, metavar="M", help="distance of rows of these tables, m")
    parser.option(
        "--video", only=RECORDING, type=Path, metavar="FILE", help="the longest ride as seen from behind, .mp4 or .gif"
    )
    parser.option(
        "--begin", type=float, default={RECORDING: 0.0}, metavar="S", help="where the video begins, s of the ride"
    )
    parser.option(
        "--duration", only=RECORDING, type=float, metavar="S", help="length of the video, s (default: to the end)"
    )
    parser.option(
        "--namespace", only=(RECORDING, REPLAY), help="which vehicle, if several were recorded (default: bike)"
    )
    parser.option("--replay", only=REPLAY, action="store_true", help="ride it again: is it the same ride, bit for bit?")
    parser.option(
        "--episode", only=REPLAY, type=int, metavar="N", help="only the rides of this number of the simulator"
    )
    parser.option("--engine", only=REPLAY, choices=ENGINES, help="replay in another engine than the recorded one")
    parser.option(
        "--time-step", only=REPLAY, type=float, metavar="S", help="replay with another step than the recorded one, s"
    )
    parser.option(
        "--explain",
        only=EXPLANATION,
        action="store_true",
        help="which parts of its observation make the policy act as it does (SHAP)",
    )
    parser.option("--policy", only=EXPLANATION, help="explain this one, by name or folder (default: the one that rode)")
    parser.option(
        "--section",
        only=EXPLANATION,
        help="explain a section of the course, or all (default: slalom; of a race all)",
    )
    parser.option("--ride", type=int, default={EXPLANATION: 1}, help="explain this ride of the recording")


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
    if any((first / name).is_file() for name in ("sweep.yaml", "runs.parquet")):
        if len(args.objects) > 1:
            raise ValueError(f"one sweep is reported at a time, got {len(args.objects)} objects")
        return SWEEP
    return RUNS if (first / "validations.csv").is_file() or (first / "run.json").is_file() else RECORDING


_ANALYZE: Final = Command(
    "figures, plots and pages from recordings, runs and sweeps; needs no ROS",
    "seconds; --explain and videos up to a minute or two",
    """\
  bike analyze ride.mcap                    print the figures, write ride.html and ride.png beside the recording
  bike analyze a.mcap b.mcap --out report   compare two rides or laps, page in report/
  bike analyze lap.mcap --csv laps.csv      all laps, aligned by arc length, as a table; --parquet for pandas
  bike analyze ride.mcap --json             the figures as JSON, and no files
  bike analyze recordings/ride_1 --json     a rosbag2 directory
  bike analyze ride.mcap --video ride.mp4   the ride as seen from behind; ride.gif --begin 20 --duration 10
  bike analyze ride.mcap --replay           ride it again: the same, bit for bit, or the first step that differs
  bike analyze ride.mcap --replay --engine whipple --time-step 0.005   how fast another physics leads elsewhere
  bike analyze ride.mcap --explain          why the policy steers as it does, on the slalom
  bike analyze ride.mcap --explain --section "full circle" --out out/circle
  bike analyze lap.mcap --explain --policy racer   a racing policy: which blocks make it choose line and pace
  bike analyze runs/seed* --out docs/images/learning_curves.png   learning curves of runs
  bike analyze sweeps/seeds                 tables with intervals, curves and a page of a sweep

A recording that was torn off (recorder killed, disk full) or damaged is analyzed as far as it can be read, with a
warning. The exit code is 1 if one of several recordings could not be read at all, if a replay is another ride, or if a
run has not finished; 2 if nothing could be read.""",
    _declare_analyze,
    _analyze_subject,
    {
        RECORDING: "analyze:run",
        REPLAY: "replay:run",
        EXPLANATION: "explain:run",
        RUNS: "curves:run",
        SWEEP: "analyze:run_sweep",
    },
)

# ---------------------------------------- sweep, reproduce and bench


def _declare_sweep(parser: CommandParser) -> None:
    parser.option("spec", type=Path, help="YAML file of the sweep")
    parser.option("--out", type=Path, required=True, help="folder of the sweep; what it holds already is kept")
    parser.option("--plan", action="store_true", help="check and estimate only")
    parser.option("--search", action="store_true", help="search the settings under `search` of the file instead")
    parser.option("--cores", type=int, help="processor cores of this machine to use (default: all)")
    parser.option("--address", help="of a running Ray cluster (default: Ray is started here, on 127.0.0.1)")
    parser.option("--mlflow", metavar="URI", help="log finished runs to MLflow at this address or file store too")
    parser.option("--retries", type=int, help="how often a run goes on whose worker was lost (default: the file's)")


_SWEEP: Final = Command(
    "do many runs from one file, and go on where they stopped",
    "hours to days; --plan estimates it",
    """\
  bike sweep seeds.yaml --out sweeps/seeds              what is missing of the sweep, on all cores
  bike sweep seeds.yaml --out sweeps/seeds --plan       check the file and estimate the hours; nothing is started
  bike sweep seeds.yaml --out sweeps/seeds --address 10.0.0.5:6379
  bike analyze sweeps/seeds                             tables with intervals, curves and a page

a file, docs/reference/sweeps.md has all of it:
  task: train
  base: {vehicle: whipple, until_finished: true}
  grid: {seed: [0, 1, 2, 3, 4], set.learner.gamma: [0.97, 0.99]}""",
    _declare_sweep,
    lambda args: WORK,
    {WORK: "sweep:run"},
)


def _declare_reproduce(parser: CommandParser) -> None:
    parser.option("paper", choices=("bicycle", "superbike"), help="publication, as in docs/")
    parser.option("--out", type=Path, required=True, help="folder; what it holds already is kept")
    parser.option("--settings", only=LEARNING, nargs="+", metavar="SETTING", help="what is learned (default: all)")
    parser.option(
        "--seeds", only=LEARNING, help="of each setting: 5 for seeds 0 to 4, 2-4 for some of them (default: 5)"
    )
    parser.option("--steps", only=LEARNING, type=int, help="most learning steps of a run (default: the paper's)")
    parser.option("--cores", only=LEARNING, type=int, help="processor cores to use (default: all)")
    parser.option("--plan", only=LEARNING, action="store_true", help="say how long it will take, and start nothing")
    parser.option("--quick", only=LEARNING, action="store_true", help="the whole way with a run that learns nothing")
    parser.option(
        "--data",
        only=DATA,
        type=Path,
        nargs="+",
        metavar="FOLDER",
        help="draw from the tables of these folders, put together; nothing is learned or ridden",
    )


_REPRODUCE: Final = Command(
    "do the experiments of a publication again",
    "days for all seeds; --plan estimates it, --quick takes minutes",
    """\
  bike reproduce bicycle --out runs/paper --plan             how long it will take; starts nothing
  bike reproduce bicycle --out runs/paper                    all settings, five seeds; the same command goes on
  bike reproduce bicycle --out runs/paper --settings prop alt3 --seeds 2 --steps 200000
  bike reproduce bicycle --out drawn --data runs/paper/data  draw figures and tables again, without learning
  bike reproduce bicycle --out late --seeds 2-4              some of the seeds, as on another machine
  bike reproduce bicycle --out all --data runs/paper/data late/data   both together
  bike reproduce bicycle --out tried --quick                 the whole way in seconds; learns nothing
  bike reproduce superbike --out runs/race --settings spdl sac   SPDL and SAC in Barcelona alone""",
    _declare_reproduce,
    lambda args: LEARNING if args.data is None else DATA,
    {LEARNING: "reproduce:run", DATA: "reproduce:run_drawing"},
)


def _declare_bench(parser: CommandParser) -> None:
    parser.option(
        "parts",
        nargs="*",
        metavar="PART",
        help="physics, environment, ros, recorder, analysis, live (default: the first three)",
    )


_BENCH: Final = Command(
    "measure speeds and compare them",
    "minutes for each part",
    "  bike bench physics environment\n  bike bench analysis --json",
    _declare_bench,
    lambda args: WORK,
    {WORK: "bench:run"},
)

COMMANDS: Final[Mapping[str, Command]] = {
    "ride": _RIDE,
    "train": _TRAIN,
    "evaluate": _EVALUATE,
    "analyze": _ANALYZE,
    "live": _LIVE,
    "sweep": _SWEEP,
    "validate": _VALIDATE,
    "bench": _BENCH,
    "export": _EXPORT,
    "reproduce": _REPRODUCE,
}

NEED_ROS: Final = frozenset({("ride", BICYCLE), ("ride", NODES), *(("live", subject) for subject in _LIVE.functions)})
"""Commands with subjects that ride or watch through nodes."""
