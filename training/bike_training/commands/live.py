"""`bike live`: a ride to watch and to steer in a browser, recorded and compared as any other."""

from __future__ import annotations

import argparse
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bike_analysis.page.live_page import live_view, render_live_page
from bike_analysis.report import analyze
from bike_policy.contract.bundle import DEFAULT_POLICY
from bike_policy.riders.classical import CLASSICAL
from bike_policy.riders.rider import make_rider
from bike_sim.course.files import load_course, shipped_tracks
from bike_sim.recording.in_use import claim_folder
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.superbike_plant import superbike_config
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_positive, check_whole, make_folder

if TYPE_CHECKING:
    from bike_training.nodes.live_ride import LiveRide

START_SHARE: Final = 0.5
"""Speed of a superbike's start by that of the theoretical lap there."""
LARGEST_PORT: Final = 65535
FOXGLOVE_PORT: Final = 8765
"""Which Foxglove's app offers when a connection is opened."""

_EXAMPLES: Final = """examples:
  bike live                                               the bicycle on the benchmark path; open the address it prints
  bike live --vehicle panigale_v4r --course barcelona     a superbike; arrows, touch or a gamepad ride it
  bike live --course circle --against out/ride/ride.mcap  beside another recording in the report at the end
  bike live --foxglove                                    its topics for Foxglove's app as well, at ws://127.0.0.1:8765

The page is served at 127.0.0.1 only, and its address has a token. Ctrl-C ends the ride and writes the report."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = _EXAMPLES
    parser.add_argument("--vehicle", default="whipple", help="name or file of a vehicle (default: %(default)s)")
    parser.add_argument("--course", help="name or file of a course (default: benchmark; barcelona for superbikes)")
    parser.add_argument("--rider", help=f"the computer's rider (default: {DEFAULT_POLICY}; {CLASSICAL} for superbikes)")
    parser.add_argument("--speed", type=float, default=4.0, help="of a bicycle, m/s (default: %(default)s)")
    parser.add_argument("--port", type=int, default=0, help="port of the page (default: a free one)")
    parser.add_argument(
        "--foxglove",
        type=int,
        nargs="?",
        const=FOXGLOVE_PORT,
        metavar="PORT",
        help="serve the ride's topics to Foxglove's app as well (default port: %(const)s; 0: a free one)",
    )
    parser.add_argument("--seconds", type=float, help="end after this wall-clock time (default: at Ctrl-C)")
    parser.add_argument("--against", type=Path, nargs="*", default=[], help="recordings to compare with at the end")
    parser.add_argument("--out", type=Path, default=Path("out/live"), help="folder of recording and report")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Serve the ride until it is ended, then write its report.

    Raises:
        ValueError: a broken file or value. FileNotFoundError: an unknown vehicle or course. OSError: the port is taken.
        NodeLost: the simulator or the recorder ended.
    """
    check_positive("--speed", args.speed, "m/s")
    check_whole("--port", args.port, 0, LARGEST_PORT)
    if args.foxglove is not None:
        from bike_training.nodes import foxglove_bridge  # noqa: F401 - a missing package is told before the ride

        check_whole("--foxglove", args.foxglove, 0, LARGEST_PORT)
    if args.seconds is not None:
        check_positive("--seconds", args.seconds, "s")
    make_folder("--out", args.out)
    recording = args.out / "live.mcap"
    with claim_folder(args.out):
        figures = _live(args, recording)
        print("writing the report")
        figures |= {"analysis": analyze([recording, *args.against], args.out)}
    if not args.json:
        print(f"recording: {recording}")
        print(f"report: {figures['analysis']['page']}")
    return {"schema": "bike.live/1", "ok": True, "figures": figures}


def _live(args: argparse.Namespace, recording: Path) -> dict[str, Any]:
    """Ride and serve; return what was counted."""
    from bike_training.nodes.live_ride import STATE_NAMES, LiveRide, LiveSettings  # only live rides need ROS
    from bike_training.nodes.live_server import LiveServer

    machine = load_vehicle(args.vehicle)
    powered = isinstance(machine, Superbike)
    rider = make_rider(args.rider or (CLASSICAL if powered else DEFAULT_POLICY))
    course = args.course or ("barcelona" if powered else "benchmark")
    if course not in shipped_tracks():
        load_course(course)  # refuses an unknown one before anything starts
    config = superbike_config(args.vehicle) if powered else SimulatorConfig(vehicle=args.vehicle)
    begin: dict[str, Any] = {"speed_range": (args.speed, args.speed)}
    if powered and course in shipped_tracks():
        begin = {"speed_share": START_SHARE}
    request = ResetRequest(course=course, preview=rider.preview or Preview(), **begin)

    server: LiveServer | None = None
    states = 0
    opened = ExitStack()
    begun = time.monotonic()

    def tell(message: dict[str, Any]) -> None:
        nonlocal states
        states += "state" in message
        if server is not None:
            server.publish(message)

    ride = LiveRide(LiveSettings(config, request, rider, recording), tell)
    try:
        ride.start()
        assert ride.course is not None
        view = live_view(ride.course, machine.name, powered)
        page = partial(render_live_page, view, rider.name, STATE_NAMES, powered)
        server = LiveServer(page, ride.ask, ride.status, args.port)
        server.start()
        print(f"open {server.address}", flush=True)
        if args.foxglove is not None:
            print(f"Foxglove: open connection {_bridge(opened, ride, args.foxglove)}", flush=True)
        begun = time.monotonic()
        while args.seconds is None or time.monotonic() - begun < args.seconds:
            time.sleep(0.1)
            ride.check()
        wall = time.monotonic() - begun
    except KeyboardInterrupt:
        wall = time.monotonic() - begun
    finally:
        opened.close()
        ride.end()
        if server is not None:
            server.close()
    ride.check()
    return {"states": states, "wall_s": round(wall, 1), "rider": rider.name, "course": course}


def _bridge(opened: ExitStack, ride: LiveRide, port: int) -> str:
    """Serve a ride's topics until `opened` is closed; return the address."""
    from bike_training.nodes.foxglove_bridge import FoxgloveBridge  # only who asks for it needs the package

    bridge = FoxgloveBridge(ride.domain_id, port)
    opened.callback(bridge.close)
    return bridge.address
