"""`bike live`: a ride to watch and to steer in a browser, recorded and compared as any other."""

from __future__ import annotations

import argparse
import os
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bike_analysis import compare
from bike_analysis.page.document import settings_words
from bike_analysis.page.live_page import ghost_of, live_view, render_live_page
from bike_analysis.page.race_page import PAGE_NAME
from bike_analysis.report import analyze
from bike_policy.riders.rider import make_rider
from bike_policy.riders.wheel_to_wheel import CLASSICAL
from bike_sim.course.files import kind_of, load_course, shipped_tracks
from bike_sim.sim.config import SimulatorConfig, superbike_config
from bike_sim.sim.race import RaceSettings, check_names, entries_of, race_config
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_positive, check_whole, recording_folder
from bike_training.commands.declarations import LARGEST_DOMAIN
from bike_training.progress import told_parts

if TYPE_CHECKING:
    from collections.abc import Callable

    from bike_training.nodes.live_ride import LiveThread
    from bike_training.nodes.live_server import LiveServer

START_SHARE: Final = 0.5
"""Speed of a superbike's start by that of the theoretical lap there."""
PATH_SPEED: Final = 4.0
"""Speed of a superbike's start on a path, m/s."""
LARGEST_PORT: Final = 65535
NAMESPACE: Final = "bike"
"""Of a simulator's topics, as in `bike_sim.ros.node_tools`, which only live rides load."""


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Serve a ride until it is ended, then write its report.

    Raises:
        ValueError: a broken file or value.
        FileNotFoundError: an unknown vehicle or course.
        OSError: the port is taken.
        NodeLost: the simulator or the recorder ended.
    """
    if args.speed is not None:
        check_positive("--speed", args.speed, "m/s")
    _check_page(args)
    with recording_folder(args.out, "live", args.overwrite) as out:
        recording = out / "live.mcap"
        figures = _live(args, recording)
        print("writing the report")
        figures |= {"analysis": analyze([recording, *args.against], out)}
    if not args.json:
        print(f"recording: {recording}")
        print(f"report: {figures['analysis']['page']}")
    return {"schema": "bike.live/1", "ok": True, "figures": figures}


def _check_page(args: argparse.Namespace) -> None:
    """Check what the page is served with."""
    check_whole("--port", args.port, 0, LARGEST_PORT)
    if args.foxglove is not None:
        from bike_training.nodes import foxglove_bridge  # noqa: F401 - a missing package is told before the ride

        check_whole("--foxglove", args.foxglove, 0, LARGEST_PORT)
    if args.seconds is not None:
        check_positive("--seconds", args.seconds, "s")


def _live(args: argparse.Namespace, recording: Path) -> dict[str, Any]:
    """Ride and serve; return what was counted."""
    from bike_training.nodes.live_ride import (
        LiveRide,
        LiveSettings,
        state_names,  # only live rides need ROS
    )
    from bike_training.nodes.live_server import LiveServer

    machine = load_vehicle(args.vehicle)
    powered = isinstance(machine, Superbike)
    rider, course = make_rider(args.rider), args.course
    if course not in shipped_tracks():
        load_course(course)  # refuses an unknown one before anything starts
    config = superbike_config(args.vehicle) if powered else SimulatorConfig(vehicle=args.vehicle)
    speed = PATH_SPEED if args.speed is None else args.speed
    begin: dict[str, Any] = {"speed_range": (speed, speed)}
    if powered and kind_of(course) == "circuit":
        begin = {"speed_share": START_SHARE}
    against = compare(args.against) if args.against else None  # refuses a broken recording before anything starts
    request = ResetRequest(course=course, preview=rider.preview or Preview(), **begin)

    tally = _Tally()
    ride = LiveRide(LiveSettings(config, request, rider, recording), tally.report)

    def serve() -> LiveServer:
        assert ride.course is not None
        ghost = ghost_of(against, ride.course) if against is not None else None
        view = live_view(ride.course, machine.name, powered, ghost)
        words, is_lap = settings_words(*ride.settings), ghost is not None and ghost[1]
        page = partial(render_live_page, view, rider.name, state_names(powered), powered, words=words, laps=is_lap)
        return LiveServer(page, ride.ask, ride.status, args.port)

    wall = _serve(args, ride, tally, serve)
    return {"states": tally.states, "wall_s": round(wall, 1), "rider": rider.name, "course": course}


def race(args: argparse.Namespace) -> dict[str, Any]:
    """Serve a race in which the last machine is ridden at the page until it is ended, then write the race's page.

    Raises:
        ValueError: what is no race, or a rider that cannot race.
        FileNotFoundError: an unknown vehicle, rider or circuit.
        OSError: the port is taken.
    """
    check_whole("--laps", args.laps, 1)
    settings = RaceSettings(args.course, args.laps, entries_of(args.race, CLASSICAL))
    check_names([entry.name for entry in settings.entries])
    _check_page(args)
    from bike_training.commands.race import page_of
    from bike_training.nodes.live_race import LiveRace
    from bike_training.nodes.live_ride import STATE_NAMES, LiveSettings, state_names
    from bike_training.nodes.live_server import LiveServer

    own = settings.entries[-1]
    machine, config, rider = load_vehicle(own.vehicle), race_config(settings), make_rider(own.rider)
    powered, names = isinstance(machine, Superbike), [entry.name for entry in settings.entries[:-1]]
    with recording_folder(args.out, "race", args.overwrite) as out:
        recording, tally = out / "race.mcap", _Tally()
        request = LiveSettings(config, ResetRequest(course=args.course), rider, recording)
        ride = LiveRace(settings, request, told_parts("bike live", args.json), tally.report)

        def serve() -> LiveServer:
            assert ride.course is not None
            view = live_view(ride.course, f"{own.name}, {machine.name}", powered, others=names)
            words = [f"{args.laps} laps against {', '.join(names)}", *settings_words(*ride.settings)]
            page = partial(
                render_live_page, view, rider.name, state_names(powered), powered, words=words, others=STATE_NAMES
            )
            return LiveServer(page, ride.ask, ride.status, args.port)

        wall = _serve(args, ride, tally, serve)
        figures = {"states": tally.states, "wall_s": round(wall, 1), "recording": str(recording)}
        figures |= {"page": str(page_of(recording, ride.client.race, out / PAGE_NAME))}
    if not args.json:
        print(f"recording: {recording}\nreport: {figures['page']}")
    return {"schema": "bike.live/1", "ok": True, "figures": figures}


def watch(args: argparse.Namespace) -> dict[str, Any]:
    """Serve a page of a simulator that others ride until it is ended; there is no report.

    Raises:
        ValueError: a broken value.
        OSError: the port is taken.
        NodeLost: no simulator was found to watch.
    """
    if args.domain is not None:
        check_whole("--domain", args.domain, 0, LARGEST_DOMAIN)
    _check_page(args)
    from bike_sim.ros.isolation import DOMAIN_VARIABLE
    from bike_training.nodes.live_ride import state_names
    from bike_training.nodes.live_server import LiveServer
    from bike_training.nodes.live_watch import LiveWatch

    domain = args.domain if args.domain is not None else int(os.environ.get(DOMAIN_VARIABLE) or 0)
    tally = _Tally()
    watch = LiveWatch(domain, args.namespace or NAMESPACE, tally.report)

    def page(origin: str) -> str:
        assert watch.course is not None
        view = live_view(watch.course, watch.machine, watch.powered)
        words = [f"watched at {watch.namespace} in ROS domain {domain}", "who started it rides and records"]
        words += settings_words(*watch.settings)
        return render_live_page(view, None, state_names(watch.powered), watch.powered, origin, words)

    tally.page = page
    wall = _serve(args, watch, tally, lambda: LiveServer(page, watch.ask, watch.status, args.port))
    assert watch.course is not None
    figures = {"states": tally.states, "wall_s": round(wall, 1), "vehicle": watch.machine, "course": watch.course.name}
    return {"schema": "bike.live/1", "ok": True, "figures": figures}


class _Tally:
    """Hands the messages of a ride to its page, once there is one, and counts the states."""

    def __init__(self) -> None:
        self.states = 0
        self.server: LiveServer | None = None
        self.page: Callable[[str], str] | None = None

    def report(self, message: dict[str, Any]) -> None:
        """Take a message, in the ride's thread."""
        self.states += "state" in message
        if self.server is None:
            return
        if "course" in message and self.page is not None:
            self.server.renew(self.page)
        self.server.publish(message)

    def close(self) -> None:
        """Close the page."""
        if self.server is not None:
            self.server.close()


def _serve(args: argparse.Namespace, ride: LiveThread, tally: _Tally, make_server: Callable[[], LiveServer]) -> float:
    """Start a ride or a watch and serve it until the time is up or Ctrl-C; return the wall-clock time, s."""
    begun = time.monotonic()
    with ExitStack() as opened:
        try:
            opened.callback(tally.close)  # after the ride, whose end is still told
            opened.callback(ride.end)
            ride.start()
            server = make_server()
            server.start()
            tally.server = server
            print(f"open {server.address}", flush=True)
            if args.foxglove is not None:
                print(f"Foxglove: open connection {_bridge(opened, ride, args)}", flush=True)
            begun = time.monotonic()
            while args.seconds is None or time.monotonic() - begun < args.seconds:
                time.sleep(0.1)
                ride.check()
        except KeyboardInterrupt:
            pass
        wall = time.monotonic() - begun
    ride.check()
    return wall


def _bridge(opened: ExitStack, ride: LiveThread, args: argparse.Namespace) -> str:
    """Serve a ride's topics until `opened` is closed; return the address."""
    from bike_training.nodes.foxglove_bridge import FoxgloveBridge  # only who asks for it needs the package

    bridge = FoxgloveBridge(ride.domain_id, args.foxglove, args.namespace or NAMESPACE)
    opened.callback(bridge.close)
    return bridge.address
