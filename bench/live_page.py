"""What the live page costs a simulator that runs as fast as it can, and how late the page is.

A simulator and the policy node ride in lockstep at full speed. In short windows, they ride alone, with a watcher
(`bike live --attach`) without a page, alone again, with its page in headless Chromium, which draws in software, and so
on. Each window that is watched is compared with the windows alone before and after it, so that what drifts in the
meantime falls out; of these ratios the median is printed with its 95 % bootstrap interval.

What a page costs by drawing is not what it costs by watching: on the same processors any program takes a part of the
rate. With `--stranger` there is a fourth kind of window, in which nobody watches and a process that has nothing to do
with the ride works for as much of a processor as the browser did, in bursts of the page's frames.

The figure that counts is the simulator's own processor time for a control step: wall-clock rates also hold what other
programs, Chromium among them, take of the processors. Steps and their rate are the simulator's own, from its
diagnostics, so that nobody has to listen to the states when it rides alone. The load is that of the machine before the
nodes start.

    python -m bench.live_page                                  # a bicycle
    python -m bench.live_page --vehicle panigale_v4r --course barcelona
    python -m bench.live_page --stranger                       # and beside a process that works as much as the page
    python -m bench.live_page --twins --unshown --rounds 30    # the watcher alone, without Chromium, on a busy machine
    python -m bench.live_page --free                           # at the pace of the clock
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, Final, NamedTuple

import numpy as np
import psutil
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from scipy.stats import bootstrap
from selenium import webdriver
from tqdm import tqdm

from bike_analysis.page.live_page import live_view, render_live_page
from bike_sim.ros import node_tools
from bike_sim.ros.isolation import DomainLease
from bike_training.envs.node_process import NodeProcess
from bike_training.nodes.live_messages import state_names
from bike_training.nodes.live_server import LiveServer
from bike_training.nodes.live_watch import LiveWatch

FloatArray = NDArray[np.float64]
Pages = dict[str, webdriver.Chrome | None]
"""The browser that shows a page, or None, by the name of what is measured."""
WATCHED, SHOWN, STRANGER = "watched", "shown", "beside a stranger"
FRAME: Final = 1.0 / 30.0
"""Time between the bursts of a stranger, s; a page draws as often."""
SETTLING: Final = 0.5
"""Wall-clock time after a change before reports count, s."""
REPORTS: Final = 16
"""Diagnostics of `bench.often`, ten a second, of a window."""
LATE_REPORTS: Final = 50
"""Diagnostics from its start after which a ride counts: in the first of them it may wait for the policy."""
LONGEST_WAIT: Final = 180.0
"""Wall-clock time in which reports must have come, s."""
SIZES: Final = {"1440": (1440, 900), "390": (390, 844)}


class Report(NamedTuple):
    """The simulator's account of itself.

    Attributes:
        steps: control steps since it began. rate: of late, 1/s. time: processor time since it began, s.
        doing: in its words.
    """

    steps: int
    rate: float
    time: float
    doing: str


class Ride(ExitStack):
    """A simulator and a policy in a domain of their own, and the simulator's account of itself.

    Attributes:
        domain: ROS domain. reports: newest last; the listener's thread adds to it.
    """

    def __init__(self, simulator: dict[str, Any], rider: dict[str, Any]) -> None:
        """Start the nodes and listen."""
        super().__init__()
        self.domain = self.enter_context(DomainLease()).domain_id
        self._nodes = [
            self.enter_context(NodeProcess("bench.often", simulator, self.domain)),
            self.enter_context(NodeProcess("bike_policy.drive", rider, self.domain)),
        ]
        self.reports: list[Report] = []
        context = node_tools.join(self.domain)
        self.callback(context.try_shutdown)
        node = Node("meter", context=context, enable_rosout=False, start_parameter_services=False)
        self.callback(node.destroy_node)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, node_tools.EVENT_QOS)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        listener = threading.Thread(target=executor.spin, daemon=True)
        listener.start()
        self.callback(listener.join)
        self.callback(executor.shutdown)

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith("sim_node"):
                told = {value.key: value.value for value in status.values}
                steps, rate = int(told["control_steps"]), float(told["control_steps_per_s"])
                self.reports.append(Report(steps, rate, float(told["processor_time_s"]), status.message))

    def wait(self, reports: int) -> None:
        """Wait until there are reports.

        Raises:
            NodeLost: a node has ended. RuntimeError: there are no reports, or no steps.
        """
        until = time.monotonic() + LONGEST_WAIT
        while len(self.reports) < reports and time.monotonic() < until:
            time.sleep(0.02)
            for node in self._nodes:
                node.check()
        if len(self.reports) < reports or self.reports[-1].steps == self.reports[0].steps:
            said = self.reports[-1].doing if self.reports else "it reports nothing"
            raise RuntimeError(f"the simulator makes no steps: {said}")

    def window(self) -> FloatArray:
        """Return the rate, 1/s, and the simulator's processor time for a step, s: medians between reports.

        What holds the simulator up, as another program that begins, comes in bursts that a mean would keep.
        """
        steps, rates, times = np.array([report[:3] for report in self.reports[: REPORTS + 1]]).T
        made = np.diff(steps)
        return np.array([np.median(rates[1:]), np.median(np.diff(times)[made > 0] / made[made > 0])])


def windows_of(*rides: Ride) -> FloatArray:
    """Let rides settle, and return a window of each, of the same time."""
    time.sleep(SETTLING)
    for ride in rides:
        ride.reports.clear()
    for ride in rides:
        ride.wait(REPORTS + 1)
    return np.array([ride.window() for ride in rides])


@contextmanager
def chromium(size: tuple[int, int]) -> Iterator[webdriver.Chrome]:
    """A headless browser of a size in pixels."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or "chromium"
    with tempfile.TemporaryDirectory() as profile:
        for flag in ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"):
            options.add_argument(flag)
        options.add_argument(f"--user-data-dir={profile}")
        browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
        browser.set_window_size(*size)
        try:
            yield browser
        finally:
            browser.quit()


def processor_time(browser: webdriver.Chrome) -> float:
    """Return the processor time that all processes of a browser have used so far, s."""
    processes = psutil.Process(browser.service.process.pid).children(recursive=True)
    return sum(sum(process.cpu_times()[:2]) for process in processes)


def work(share: float) -> None:
    """Work for a part of each frame, and sleep for the rest, for ever."""
    while True:
        begun = time.monotonic()
        while time.monotonic() - begun < share * FRAME:
            sum(range(1000))
        time.sleep(max(0.0, FRAME - (time.monotonic() - begun)))


@contextmanager
def stranger(share: float) -> Iterator[None]:
    """A process that works for a part of a processor."""
    process = multiprocessing.get_context("spawn").Process(target=work, args=(share,), daemon=True)
    process.start()
    try:
        yield
    finally:
        process.terminate()
        process.join()


@contextmanager
def watching(domain: int, page_open: webdriver.Chrome | None) -> Iterator[None]:
    """`bike live --attach` for a while, with its page or without."""
    servers: list[LiveServer] = []
    watch = LiveWatch(domain, node_tools.NAMESPACE, lambda message: [server.publish(message) for server in servers])
    with ExitStack() as opened:
        watch.start()
        opened.callback(watch.end)
        assert watch.course is not None
        view = live_view(watch.course, watch.machine, watch.powered)
        server = LiveServer(
            lambda origin: render_live_page(view, None, state_names(watch.powered), watch.powered, origin),
            watch.ask,
            watch.status,
        )
        server.start()
        opened.callback(server.close)
        servers.append(server)
        if page_open is not None:
            page_open.get(server.address)
            opened.callback(page_open.get, "about:blank")
        yield


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", default="whipple")
    parser.add_argument("--course", default="circle")
    parser.add_argument("--size", choices=SIZES, default="1440", help="width of the page, pixels")
    parser.add_argument("--rounds", type=int, default=12, help="of 8 to 14 s each")
    parser.add_argument("--unshown", action="store_true", help="watch without a page")
    parser.add_argument("--stranger", action="store_true", help="also beside a process that works as much as the page")
    parser.add_argument("--twins", action="store_true", help="watch one of two rides at the same time, in turns")
    parser.add_argument("--free", action="store_true", help="at the pace of the clock")
    args = parser.parse_args()
    if args.stranger and (args.unshown or args.twins):
        parser.error("a stranger works as much as a page beside one ride: not with --unshown or --twins")
    print(f"load of the last minute on {os.cpu_count()} processors before: {os.getloadavg()[0]:.2f}", flush=True)
    # A ride that ends begins anew: at the pace of the clock, an answer that comes too late lets a bicycle fall.
    simulator: dict[str, Any] = {"vehicle": args.vehicle, "course": args.course, "auto_reset": "end"}
    powered = args.vehicle != "whipple"
    simulator |= {"time_step": 0.002} if powered else {"speed": 4.0}
    if args.free:
        simulator |= {"mode": "free", "real_time_factor": 1.0}
    rider = {"policy": "classical" if powered else "lqr"}
    with ExitStack() as opened:
        rides = [opened.enter_context(Ride(simulator, rider)) for _ in range(2 if args.twins else 1)]
        pages: Pages = {WATCHED: None}
        if not args.unshown:
            pages[SHOWN] = opened.enter_context(chromium(SIZES[args.size]))
        if args.stranger:
            pages[STRANGER] = None
        for ride in rides:
            ride.wait(LATE_REPORTS)
        (measure_twins if args.twins else measure_in_turns)(rides, pages, args.rounds)


def measure_in_turns(rides: Sequence[Ride], pages: Pages, rounds: int) -> None:
    """Watch a ride and leave it alone, in turns, and print what was found."""
    (ride,) = rides
    alone, shown = [windows_of(ride)[0]], Shown()
    watched: dict[str, list[FloatArray]] = {name: [] for name in pages}
    for name in progress(list(pages) * rounds):
        with stranger(shown.share) if name == STRANGER else watching(ride.domain, pages[name]):
            shown.begin(pages[name])
            watched[name].append(windows_of(ride)[0])
            shown.end(pages[name])
        alone.append(windows_of(ride)[0])
    print_alone(alone)
    beside = 0.5 * (np.array(alone[:-1]) + np.array(alone[1:]))  # of the windows before and after
    for place, (name, windows) in enumerate(watched.items()):
        print_ratios(name, np.array(windows) / beside[place :: len(watched)])
    shown.print()


def measure_twins(rides: Sequence[Ride], pages: Pages, rounds: int) -> None:
    """Watch one of two rides, in turns, and print what was found."""
    alone, shown = [], Shown()
    ratios: dict[str, list[FloatArray]] = {name: [] for name in pages}
    for name in progress(list(pages) * rounds):
        pair = []
        for place, ride in enumerate(rides):
            with watching(ride.domain, pages[name]):
                shown.begin(pages[name])
                windows = windows_of(*rides)
                shown.end(pages[name])
            pair.append(windows[place] / windows[1 - place])
            alone.append(windows[1 - place])
        ratios[name].append(np.sqrt(pair[0] * pair[1]))  # what the two rides have of their own falls out
    print_alone(alone)
    for name, found in ratios.items():
        print_ratios(name, np.array(found))
    shown.print()


def progress(names: Sequence[str]) -> Iterable[str]:
    """Show which window it is; in a log file a line each ten seconds."""
    found: Iterable[str] = tqdm(names, unit="window", mininterval=0.1 if sys.stderr.isatty() else 10.0)
    return found


class Shown:
    """What a page has drawn, and the processors meanwhile."""

    def __init__(self) -> None:
        self._drawn: list[tuple[float, float]] = []
        self._busy: list[float] = []
        self._shares: list[float] = []
        self._begun = (0.0, 0.0)

    @property
    def share(self) -> float:
        """The part of a processor that the browser has used, at most 1; the median of its windows."""
        return min(1.0, float(np.median(self._shares)))

    def begin(self, page: webdriver.Chrome | None) -> None:
        """Begin a window."""
        psutil.cpu_percent()
        if page is not None:
            self._begun = time.monotonic(), processor_time(page)

    def end(self, page: webdriver.Chrome | None) -> None:
        """End a window; one without a page does not count."""
        if page is not None:
            self._busy.append(psutil.cpu_percent())
            begun, used = self._begun
            self._shares.append((processor_time(page) - used) / (time.monotonic() - begun))
            found = page.execute_script("const l = document.querySelector('.view').view.live; return [l.rate, l.delay]")
            self._drawn.append(found)

    def print(self) -> None:
        """Print the medians, if there are any."""
        if self._drawn:
            rate, delay = np.median(self._drawn, axis=0)
            print(f"page: {rate:.0f} frames a second, {delay:.0f} ms from state to screen")
            print(f"processors busy with the page shown: {np.median(self._busy):.0f} %", end=", ")
            print(f"the browser's share of one: {self.share:.2f}")


def print_alone(windows: Sequence[FloatArray]) -> None:
    """Print the medians of windows that nobody watched."""
    rate, used = np.median(windows, axis=0)
    print(f"alone: {rate:.0f} steps/s, {1e6 * used:.0f} us of the simulator's processor time a step")


def print_ratios(name: str, ratios: FloatArray) -> None:
    """Print the median of each column with its 95 % bootstrap interval."""
    rate, used = map(told, ratios.T)
    print(f"{name}, of alone: rate {rate}; simulator's processor time a step {used}")


def told(ratios: FloatArray) -> str:
    """Return the median with its 95 % bootstrap interval."""
    if len(ratios) < 2:
        return f"{ratios[0]:.3f}"
    low, high = bootstrap((ratios,), np.median, method="percentile", rng=0).confidence_interval
    return f"{np.median(ratios):.3f} ({low:.3f} to {high:.3f})"


if __name__ == "__main__":
    main()
