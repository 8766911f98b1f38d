"""What the live page costs a simulator that runs as fast as it can, and how late the page is.

A simulator and the policy node ride in lockstep at full speed. In rounds, they ride alone, with a watcher
(`bike live --attach`) without a page, and with its page in headless Chromium, which draws in software. The rate of
control steps is the simulator's own, from its diagnostics, so that nobody has to listen to the states when it rides
alone. A ratio is taken in each round, of neighbours in time, and the median of the rounds counts. Where other programs
want the processors too, the ratio of the processor time that simulator and policy take for a step says more. The load
is that of the machine before the nodes start.

    python -m bench.live_page                                  # a bicycle
    python -m bench.live_page --vehicle panigale_v4r --course barcelona
    python -m bench.live_page --free                           # at the pace of the clock: frames and delay alone
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, Final

import numpy as np
import psutil
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from selenium import webdriver

from bike_analysis.page.live_page import live_view, render_live_page
from bike_sim.ros import node_tools
from bike_sim.ros.isolation import DomainLease, prepare_discovery
from bike_training.envs.node_process import NodeProcess
from bike_training.nodes.live_messages import state_names
from bike_training.nodes.live_server import LiveServer
from bike_training.nodes.live_watch import LiveWatch

ALONE, WATCHED, SHOWN = "alone", "watched", "shown"
SETTLING: Final = 2.5
"""Wall-clock time after a change before the rate counts, s."""
REPORTS: Final = 4
"""Diagnostics, one a second, of a window."""
LONGEST_START: Final = 60.0
"""Wall-clock time in which the simulator must have reported a ride, s."""
SIZES: Final = {"1440": (1440, 900), "390": (390, 844)}


class Rates:
    """The simulator's own rate of control steps, from its diagnostics, and what the nodes' processes take for one."""

    def __init__(self, domain: int, nodes: Sequence[NodeProcess]) -> None:
        """Join a domain."""
        self._processes = [psutil.Process(node.process.pid) for node in nodes]
        prepare_discovery()
        self._context = Context()
        self._context.init(args=[], domain_id=domain)
        self._node = Node("rates", context=self._context, enable_rosout=False, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._reports: list[tuple[float, float, float]] = []  # rate, 1/s; steps; processor time of the nodes, s
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, node_tools.EVENT_QOS)

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith("sim_node"):
                figures = {value.key: value.value for value in status.values}
                spent = sum(sum(process.cpu_times()[:2]) for process in self._processes)
                self._reports.append((float(figures["control_steps_per_s"]), float(figures["commands_taken"]), spent))

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def measured(self) -> tuple[float, float]:
        """Return the mean rate of the next reports, 1/s, and the nodes' processor time for a step, s."""
        self._reports.clear()
        while len(self._reports) <= REPORTS:
            self.wait(0.1)
        rates, steps, spent = zip(*self._reports, strict=True)
        # The first report began before.
        return float(np.mean(rates[1:])), (spent[-1] - spent[0]) / (steps[-1] - steps[0])

    def wait_for_ride(self) -> None:
        """Wait until there are steps.

        Raises:
            TimeoutError: there are none.
        """
        until = time.monotonic() + LONGEST_START
        while not self._reports or self._reports[-1][0] <= 1.0:
            self.wait(0.2)
            if time.monotonic() > until:
                raise TimeoutError(f"no ride within {LONGEST_START:g} s")

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


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
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--free", action="store_true", help="at the pace of the clock")
    args = parser.parse_args()
    print(f"load of the last minute on {os.cpu_count()} processors before: {os.getloadavg()[0]:.2f}")
    simulator: dict[str, Any] = {"vehicle": args.vehicle, "course": args.course}
    powered = args.vehicle != "whipple"
    simulator |= {"time_step": 0.002} if powered else {"speed": 4.0}
    if args.free:
        simulator |= {"mode": "free", "real_time_factor": 1.0}
    rider = {"policy": "classical" if powered else "lqr"}
    with ExitStack() as opened:
        domain = opened.enter_context(DomainLease()).domain_id
        nodes = [
            opened.enter_context(NodeProcess("bike_sim.ros.sim_node", simulator, domain)),
            opened.enter_context(NodeProcess("bike_policy.drive", rider, domain)),
        ]
        rates = Rates(domain, nodes)
        opened.callback(rates.close)
        browser = opened.enter_context(chromium(SIZES[args.size]))
        rates.wait_for_ride()
        measure(rates, browser, domain, args.rounds)
        for node in nodes:
            node.check()


def measure(rates: Rates, browser: webdriver.Chrome, domain: int, rounds: int) -> None:
    """Ride in rounds and print rates, ratios, frames and delay."""
    found: dict[str, list[tuple[float, float]]] = {ALONE: [], WATCHED: [], SHOWN: []}
    frames, delays, busy = [], [], []
    for _ in range(rounds):
        rates.wait(SETTLING)
        found[ALONE].append(rates.measured())
        with watching(domain, None):
            rates.wait(SETTLING)
            found[WATCHED].append(rates.measured())
        with watching(domain, browser):
            rates.wait(SETTLING)
            psutil.cpu_percent()
            found[SHOWN].append(rates.measured())
            busy.append(psutil.cpu_percent())
            live = browser.execute_script(
                "const l = document.querySelector('.view').view.live; return [l.rate, l.delay]"
            )
            frames.append(live[0])
            delays.append(live[1])
    alone = np.array(found[ALONE])
    for name, values in found.items():
        ratios = np.array(values) / alone
        low, middle, high = np.percentile(ratios[:, 0], [25, 50, 75])
        rate, spent = np.median(values, axis=0)
        print(
            f"{name:8} {rate:7.0f} steps/s, {middle:.3f} of alone (quartiles {low:.3f} to {high:.3f}); "
            f"{1e6 * spent:.0f} us of the nodes' processor time for a step, {np.median(ratios[:, 1]):.3f} of alone"
        )
    print(f"page: {np.median(frames):.0f} frames a second, {np.median(delays):.0f} ms from state to screen")
    print(f"processors busy with the page shown: {np.median(busy):.0f} %")


if __name__ == "__main__":
    main()
