"""Cost of the live page for a simulator that runs as fast as it can, and delay of the page.

A simulator and the policy node ride in lockstep at full speed. In short windows, they ride alone, with a watcher
(`bike live --attach`) without a page, alone again, with its page in headless Chromium, which draws in software, and so
on. Each window that is watched is compared with the windows alone before and after it, so that what drifts in the
meantime falls out. Figures are the medians of these ratios with their quartiles.

The figure that counts is the simulator's own processor time for a control step: wall-clock rates also hold what other
programs, Chromium among them, take of the processors. Steps and their rate are the simulator's own, from its
diagnostics, so that nobody has to listen to the states when it rides alone.

As a program it is the simulator node with more frequent diagnostics.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from selenium import webdriver
from selenium.webdriver.support.ui import WebDriverWait
from tqdm import tqdm

from bike_analysis.page.live_page import live_view, render_live_page
from bike_sim.ros import node_tools, sim_node
from bike_sim.ros.isolation import DomainLease
from bike_training.envs.node_process import NodeProcess
from bike_training.nodes.live_ride import state_names
from bike_training.nodes.live_server import LiveServer
from bike_training.nodes.live_watch import LiveWatch

FloatArray = NDArray[np.float64]
SETTLING: Final = 0.5
"""Wall-clock time after a change before reports count, s."""
REPORT_PERIOD: Final = 0.1
"""Wall-clock time between two diagnostics of the measured simulator, s; it is 1 s otherwise."""
REPORTS: Final = 16
"""Diagnostics of a window."""
FIRST_REPORTS: Final = 50
"""Diagnostics from its start after which a ride counts: in the first of them it may wait for the policy."""
REPORT_TIMEOUT: Final = 180.0
"""Wall-clock time in which reports must have come, s."""
DRAWN: Final = "const live = document.querySelector('.view')?.view?.live; return [live?.rate, live?.delay]"
"""Frames that the page draws, 1/s, and how late, ms; nothing until it has drawn some."""
PAGE_SIZE: Final = (1440, 900)
"""Pixels."""


class Ride(ExitStack):
    """A simulator and a policy in a domain of their own, and the simulator's account of itself.

    Attributes:
        domain: ROS domain.
        reports: control steps and processor time, s, since it began, and its rate of late, 1/s; newest last. The
            listener's thread adds to it.
        status: its last message.
    """

    def __init__(self, simulator: dict[str, Any], rider: dict[str, Any]) -> None:
        """Start the nodes and listen."""
        super().__init__()
        self.domain = self.enter_context(DomainLease()).domain_id
        self._nodes = [
            self.enter_context(NodeProcess("bench.live_page", simulator, self.domain)),
            self.enter_context(NodeProcess("bike_policy.drive", rider, self.domain)),
        ]
        self.reports: list[tuple[float, float, float]] = []
        self.status = "it reports nothing"
        node, left = node_tools.GuestNode("meter", self.domain), threading.Event()
        self.callback(node.close)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_report, node_tools.EVENT_QOS)

        def listen() -> None:
            while not left.is_set():
                node.spin_once(0.1)

        listener = threading.Thread(target=listen, daemon=True)
        listener.start()
        self.callback(listener.join)
        self.callback(left.set)

    def _on_report(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.endswith("sim_node"):
                values = {value.key: value.value for value in status.values}
                names = ("control_steps", "processor_time_s", "control_steps_per_s")
                steps, used, rate = (float(values[name]) for name in names)
                self.reports.append((steps, used, rate))
                self.status = status.message

    def wait(self, reports: int) -> None:
        """Wait until there are reports, with steps between them: the policy may still start, on a busy machine.

        Raises:
            NodeLost: a node has ended.
            RuntimeError: there are no reports, or no steps, in REPORT_TIMEOUT.
        """
        until = time.monotonic() + REPORT_TIMEOUT
        while len(self.reports) < reports or self.reports[-1][0] == self.reports[-reports][0]:
            time.sleep(0.02)
            for node in self._nodes:
                node.check()
            if time.monotonic() > until:
                raise RuntimeError(f"the simulator makes no steps: {self.status}")

    def window(self) -> FloatArray:
        """Return the rate, 1/s, and the simulator's processor time for a step, s: medians between reports of now.

        What holds the simulator up, as another program that begins, comes in bursts that a mean would keep.
        """
        time.sleep(SETTLING)
        self.reports.clear()
        self.wait(REPORTS + 1)
        steps, times, rates = np.array(self.reports[-REPORTS - 1 :]).T
        made = np.diff(steps)
        return np.array([np.median(rates[1:]), np.median(np.diff(times)[made > 0] / made[made > 0])])


@contextmanager
def chromium() -> Iterator[webdriver.Chrome]:
    """A headless browser."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or "chromium"
    with tempfile.TemporaryDirectory() as profile:
        for flag in ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"):
            options.add_argument(flag)
        options.add_argument(f"--user-data-dir={profile}")
        browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
        browser.set_window_size(*PAGE_SIZE)
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
            # On a busy machine a page opens, and draws only after the window.
            WebDriverWait(page_open, REPORT_TIMEOUT).until(lambda page: None not in page.execute_script(DRAWN))
        yield


def measure(rounds: int = 12, with_page: bool = True) -> dict[str, float]:
    """Watch a bicycle's ride and leave it alone, in turns.

    Args:
        rounds: windows of each kind.
        with_page: whether to show the page in Chromium too.

    Returns:
        Figures of the ride alone, ratios of the watched windows to it with their quartiles, and the page's own figures.
    """
    # A ride that ends begins anew: an answer that comes too late lets a bicycle fall.
    simulator = {"vehicle": "whipple", "course": "circle", "auto_reset": "end", "speed": 4.0}
    with Ride(simulator, {"policy": "lqr"}) as ride:
        pages: dict[str, webdriver.Chrome | None] = {"live_watched": None}
        if with_page:
            pages["live_page"] = ride.enter_context(chromium())
        ride.wait(FIRST_REPORTS)
        alone, watched, drawn = [ride.window()], [], []
        for _ in tqdm(range(rounds), unit="round", mininterval=0.1 if sys.stderr.isatty() else 10.0):
            for page in pages.values():
                with watching(ride.domain, page):
                    watched.append(ride.window())
                    if page is not None:
                        drawn.append(page.execute_script(DRAWN))
                alone.append(ride.window())
    rate, used = np.median(alone, axis=0)
    figures = {"live_alone_steps_per_s": float(rate), "live_alone_processor_us_per_step": 1e6 * float(used)}
    ratios = 2.0 * np.array(watched) / (np.array(alone[:-1]) + np.array(alone[1:]))
    for place, name in enumerate(pages):
        for kind, values in zip(("rate", "processor"), ratios[place :: len(pages)].T, strict=True):
            low, middle, high = map(float, np.percentile(values, [25.0, 50.0, 75.0]))
            known = {"ratio": middle, "ratio_lower_quartile": low, "ratio_upper_quartile": high}
            figures |= {f"{name}_{kind}_{text}": value for text, value in known.items()}
    if drawn:
        frames, delay = np.median(drawn, axis=0)
        figures |= {"live_page_frames_per_s": float(frames), "live_page_delay_ms": float(delay)}
    return figures


def main() -> None:
    """Run the simulator node with more frequent diagnostics, for short windows."""
    sim_node.REPORT_PERIOD = REPORT_PERIOD  # type: ignore[misc]
    sim_node.HOUSEKEEPING_PERIOD = 0.5 * REPORT_PERIOD  # type: ignore[misc]
    sim_node.main()


if __name__ == "__main__":
    main()
