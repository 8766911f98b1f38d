"""A live ride: its page in Chromium, steered by keys, and what its server refuses."""

from __future__ import annotations

import json
import math
import shutil
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from selenium import webdriver
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from bike_analysis import compare, open_ride
from bike_analysis.page.document import recorded_settings, settings_words
from bike_analysis.page.live_page import ghost_of, live_view, render_live_page
from bike_analysis.page.view import Series
from bike_policy.riders.rider import make_rider
from bike_policy.riders.stanley import ManualRider
from bike_sim.course.course import Course
from bike_sim.course.elements import Arc
from bike_sim.physics.bicycle.steady_turn import steady_turns
from bike_sim.ros.isolation import DomainLease
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.race import RaceSettings, entries_of, race_config
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_training.envs.node_process import NodeLost, NodeProcess
from bike_training.nodes import live_watch
from bike_training.nodes.live_race import LiveRace
from bike_training.nodes.live_ride import PACES, STATE_NAMES, LiveRide, LiveSettings, checked_request, state_names
from bike_training.nodes.live_server import MAX_REQUEST, LiveServer
from bike_training.nodes.live_watch import LiveWatch
from bike_training.nodes.race_recording import RecordedRace
from tests.circuits import OVAL

CIRCLE = """\
format: bike.course/1
name: small circle
closed: true
elements:
  - {arc: {radius_m: 8.0, angle_deg: 360.0}, section: circle}
"""


# ---- what a page may ask for ----------------------------------------------------------------------------------------


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(), lambda c: st.lists(c) | st.dictionaries(st.text(), c)
    )
)
def test_whatever_a_page_sends_becomes_a_request_in_bounds_or_none(message: Any) -> None:
    for kind in ("input", "pace", "pause", "rider", "step", "reset", message):
        asked = {"type": kind, "steering": message, "throttle": message, "factor": message, "on": message}
        request = checked_request(asked | {"hands": message, "balance": message})
        if request is None:
            continue
        assert all(abs(request.get(name, 0.0)) <= 1.0 for name in ("steering", "throttle"))
        assert PACES[0] <= request.get("factor", 1.0) <= PACES[1]
        assert isinstance(request.get("on", True), bool)
    assert checked_request(message if not isinstance(message, dict) else None) is None


def test_wishes_beyond_the_bounds_are_clipped() -> None:
    asked = {"type": "input", "steering": 7.0, "throttle": -3}
    assert checked_request(asked) == {"type": "input", "steering": 1.0, "throttle": -1.0}
    assert checked_request(asked | {"steering": float("nan")}) is None
    assert checked_request({"type": "pace", "factor": 1e9}) == {"type": "pace", "factor": PACES[1]}


@pytest.mark.parametrize("wish", [0.4, -0.4])
def test_a_wish_is_a_lean_that_the_loop_balances(wish: float) -> None:
    """The lean is that of the steady turn (`bike_sim.physics.bicycle.steady_turn`); to the left is a negative roll."""
    with closing(Simulator(SimulatorConfig(engine="whipple"))) as simulator:
        snapshot = simulator.reset(ResetRequest(course="line", speed_range=(4.0, 4.0)))
        rider = ManualRider()
        rider.begin(simulator.vehicle, simulator.course, 0.05, simulator.preview)
        rider.steering = wish
        for _ in range(120):
            answer = rider.command(snapshot)
            assert answer is not None
            snapshot = simulator.step(*answer)
        assert not snapshot.fallen
        turns = steady_turns(simulator.vehicle, snapshot.speed)
        curvature = abs(rider.wanted(snapshot))
        lean = -math.copysign(float(np.interp(curvature, turns.curvature, -turns.roll)), wish)
        assert snapshot.state[3] == pytest.approx(lean, abs=math.radians(1.5))
        rider.balances = False
        assert rider.command(snapshot) == (wish, 0.0)


@pytest.mark.parametrize("speed", [3.0, 6.0])
def test_no_wishes_throw_off_who_is_balanced(speed: float) -> None:
    with closing(Simulator(SimulatorConfig(engine="whipple"))) as simulator:
        for held in (4, 30):
            snapshot = simulator.reset(ResetRequest(course="line", speed_range=(speed, speed)))
            rider = ManualRider()
            rider.begin(simulator.vehicle, simulator.course, 0.05, simulator.preview)
            for k in range(240):
                rider.steering = 1.0 if k // held % 2 else -1.0
                answer = rider.command(snapshot)
                assert answer is not None
                snapshot = simulator.step(*answer)
                assert not snapshot.fallen, f"each wish held for {held} commands"


# ---- the server -----------------------------------------------------------------------------------------------------


def page_of(origin: str) -> str:
    course = Course.from_elements("ring", [Arc(8.0, 2.0 * np.pi)], closed=True)
    return render_live_page(live_view(course, "whipple", False), "whipple", STATE_NAMES, False, origin)


@pytest.fixture
def served() -> Iterator[tuple[LiveServer, list[dict[str, Any]]]]:
    asked: list[dict[str, Any]] = []
    server = LiveServer(page_of, asked.append, lambda: {"status": {}})
    server.start()
    yield server, asked
    server.close()


def status_of(address: str, **headers: str) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=5) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def test_only_this_machine_with_the_token_gets_the_page(served: Any) -> None:
    server, _ = served
    bare = f"http://127.0.0.1:{server.port}/"
    assert status_of(server.address) == 200
    assert [status_of(bare), status_of(bare + "ws"), status_of(server.address + "x")] == [404, 404, 404]
    assert status_of(server.address, Host="evil.example") == 421  # a name that was made to lead here
    others = [info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)]
    for other in {name for name in others if not name.startswith("127.")}:
        with pytest.raises(OSError, match="refused"):
            socket.create_connection((other, server.port), timeout=2)


def test_only_the_pages_own_origin_may_talk(served: Any) -> None:
    server, asked = served
    address = server.address.replace("http", "ws") + "ws"
    for origin in ("http://evil.example", f"http://localhost:{server.port}", None):
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin=origin)
    with connect(address, origin=f"http://127.0.0.1:{server.port}") as page:
        assert json.loads(page.recv()) == {"status": {}}
        page.send("[1")
        page.send(json.dumps({"type": "rm -rf"}))
        page.send(json.dumps({"type": "pace", "factor": 2}))
        server.publish({"state": [1.0]})
        assert json.loads(page.recv()) == {"state": [1.0]}
        WebDriverWait(None, 5).until(lambda _: asked)
        assert asked == [{"type": "pace", "factor": 2.0}]
        page.send("x" * (MAX_REQUEST + 1))
        with pytest.raises(Exception, match="1009"):
            page.recv(timeout=5)


def test_another_course_is_another_page(served: Any) -> None:
    server, _ = served
    server.renew(lambda origin: f"a page for {origin}")
    with urllib.request.urlopen(server.address, timeout=5) as answer:
        assert answer.read() == f"a page for ws://127.0.0.1:{server.port}".encode()


def test_a_slow_page_misses_states_and_no_lap(served: Any) -> None:
    server, _ = served
    address = server.address.replace("http", "ws") + "ws"
    with connect(address, origin=f"http://127.0.0.1:{server.port}", max_queue=1) as page:
        assert json.loads(page.recv()) == {"status": {}}
        server.publish({"lap": 12.5})
        long = "x" * 100_000  # so that the sockets' buffers do not take them all
        for number in range(400):
            server.publish({"state": [number, long]})
        server.publish({"lap": 13.5})
        laps, states = [], []
        while len(laps) < 2:
            message = json.loads(page.recv(timeout=20))
            (laps if "lap" in message else states).append(message)
        assert [message["lap"] for message in laps] == [12.5, 13.5]
        numbers = [message["state"][0] for message in states]
        assert numbers == sorted(numbers)
        assert 0 < len(numbers) < 400


# ---- a ride ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[webdriver.Chrome]:
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("the page tests need the Debian packages chromium and chromium-driver, which `make test` installs")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"):
        options.add_argument(flag)
    options.add_argument(f"--user-data-dir={tmp_path / 'profile'}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    chrome = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    chrome.set_window_size(800, 600)
    yield chrome
    chrome.quit()


def touch(browser: webdriver.Chrome, kind: str, *points: tuple[float, float]) -> None:
    at = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
    browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})


def test_two_thumbs_lean_and_brake(browser: webdriver.Chrome) -> None:
    asked: list[dict[str, Any]] = []
    course = Course.from_elements("ring", [Arc(8.0, 2.0 * np.pi)], closed=True)
    page = lambda origin: render_live_page(live_view(course, "r1", True), "classical", state_names(True), True, origin)  # noqa: E731
    server = LiveServer(page, asked.append, lambda: {"status": {"hands": False, "pace": 1.0}})
    server.start()
    try:
        phone = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
        browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})
        browser.get(server.address)
        wait = WebDriverWait(browser, 20)
        wait.until(
            lambda b: b.execute_script("return document.querySelector('.view').view.live?.socket.readyState") == 1
        )
        find = "return ['steering', 'throttle'].map(name => document.querySelector(`[data-pad=${name}]`))"
        boxes = browser.execute_script(f"{find}.map(pad => pad.getBoundingClientRect())")
        left, right = ((box["x"], box["y"], box["width"], box["height"]) for box in boxes)
        at = lambda box, x, y: (box[0] + x * box[2], box[1] + y * box[3])  # noqa: E731
        inputs = lambda: [{k: round(v, 1) for k, v in a.items() if k != "type"} for a in asked if a["type"] == "input"]  # noqa: E731
        touch(browser, "touchStart", at(left, 0.25, 0.5))
        wait.until(lambda _: {"steering": 0.5, "throttle": 0.0} in inputs())
        assert asked[0] == {"type": "rider", "hands": True, "balance": True}
        touch(browser, "touchStart", at(left, 0.25, 0.5), at(right, 0.5, 0.9))
        wait.until(lambda _: inputs()[-1] == {"steering": 0.5, "throttle": -0.8})
        touch(browser, "touchMove", at(left, 0.7, 0.2), at(right, 0.5, 0.1))
        wait.until(lambda _: inputs()[-1] == {"steering": -0.4, "throttle": 0.8})
        assert browser.execute_script("return scrollY") == 0, "who rides does not scroll"
        touch(browser, "touchEnd")
        wait.until(lambda _: inputs()[-1] == {"steering": 0.0, "throttle": 0.0})
    finally:
        server.close()


def test_a_ghost_rides_along_and_begins_again_with_each_lap(browser: webdriver.Chrome) -> None:
    course = Course.from_elements("ring", [Arc(8.0, 2.0 * np.pi)], closed=True)
    time_s = np.linspace(0.0, 10.0, 201)
    angle = 0.5 * time_s
    columns = {"time": time_s, "distance": 8.0 * angle, "x": 8.0 * np.sin(angle), "y": 8.0 - 8.0 * np.cos(angle)}
    columns |= {"yaw": angle, "roll": -10.0 * np.ones(201), "speed": 4.0 * np.ones(201)}
    ghost = Series("a lap", columns, "orange"), True
    view = live_view(course, "whipple", False, ghost)
    page = lambda origin: render_live_page(view, "lqr", STATE_NAMES, False, origin, laps=True)  # noqa: E731
    server = LiveServer(page, lambda _: None, lambda: {"status": {"hands": False, "pace": 1.0}})
    server.start()
    where = """const { view } = document.querySelector(".view"), map = view.parts.find(part => part.marks);
      const row = view.rowIn(view.series[1], "time"), { x, y } = view.series[1].columns;
      return [row, row < 0 ? null : [x[row], y[row]], view.main.columns.time.at(-1)];"""

    def ghost_at(seconds: float) -> Any:
        for now in (seconds - 0.1, seconds):
            server.publish({"state": [now, *[0.0] * (len(STATE_NAMES) - 1)], "sent": 1e3 * time.time()})
        WebDriverWait(browser, 20).until(lambda b: b.execute_script(where)[2] == pytest.approx(seconds))
        return browser.execute_script(where)[1]

    try:
        browser.get(server.address)
        live = "return document.querySelector('.view').view?.live?.socket.readyState"
        WebDriverWait(browser, 20).until(lambda b: b.execute_script(live) == 1)
        server.publish({"reset": True})
        assert ghost_at(3.0) == pytest.approx([8.0 * math.sin(1.5), 8.0 - 8.0 * math.cos(1.5)], abs=0.2)
        server.publish({"event": "lap 1", "lap": 3.0})
        assert ghost_at(4.0) == pytest.approx([8.0 * math.sin(0.5), 8.0 - 8.0 * math.cos(0.5)], abs=0.2)
        assert ghost_at(14.0) is None, "it has ended its lap"
        server.publish({"reset": True})
        assert ghost_at(2.0) == pytest.approx([8.0 * math.sin(1.0), 8.0 - 8.0 * math.cos(1.0)], abs=0.2)
        assert browser.get_log("browser") == []
    finally:
        server.close()


RIDE_BY_KEYS = """
  const view = document.querySelector(".view").view, { live } = view, names = { 1: "ArrowLeft", "-1": "ArrowRight" };
  let held = 0;
  const press = (kind, side) => dispatchEvent(new KeyboardEvent(kind, { key: names[side] }));
  const look = () => {
    const { columns } = view.main, n = columns.time.length - 1, along = columns.yaw[n] - columns.distance[n] / 8;
    const wish = 0.44 - 0.27 * (columns.error[n] + 3 * along), off = live.command.steering - wish;
    const side = Math.abs(off) < 0.06 ? 0 : off > 0 ? -1 : 1;
    if (side !== held) {
      if (held) press("keyup", held);
      if (side) press("keydown", side);
      held = side;
    }
    const near = Math.abs(columns.error[n]) < 0.7 && Math.abs(along) < 0.15;  // fit to be taken over
    if (!live.laps.length || !near) return requestAnimationFrame(look);
    if (held) press("keyup", held);
    live.ridden = true;
  };
  look();"""
"""Rides around a circle of 8 m as a person would: presses an arrow until the lean leads back to the line."""


MAX_RIDE = 90.0
"""Simulated time in which a test's laps must be ridden, s; a lap takes 13."""
SILENCE = 30.0
"""Wall-clock time without a new state after which a ride has stopped, s."""


def ridden_until(done: Callable[[], Any], told: list[dict[str, Any]], each: Callable[[], Any] = lambda: None) -> None:
    """Wait for something in the ride's own time, and do `each` at every look: a busy machine rides slower."""
    states = lambda: [message["state"] for message in told if "state" in message]  # noqa: E731
    begun, last, heard_at = states()[-1][0], None, time.monotonic()
    while not done():
        now = states()[-1][0]
        if now != last:
            last, heard_at = now, time.monotonic()
        assert now - begun < MAX_RIDE, f"not within {MAX_RIDE} s of the ride"
        assert time.monotonic() - heard_at < SILENCE, f"the ride stopped: {[m for m in told if 'event' in m][-3:]}"
        each()
        time.sleep(0.2)


@pytest.mark.slow
@pytest.mark.ros
def test_a_lap_is_ridden_by_keys_and_lies_beside_another(browser: webdriver.Chrome, tmp_path: Path) -> None:
    course = tmp_path / "small.yaml"
    course.write_text(CIRCLE)
    request = ResetRequest(course=str(course), speed_range=(4.0, 4.0))
    told, servers, report = listeners()
    path = tmp_path / "live.mcap"

    ride = LiveRide(LiveSettings(SimulatorConfig(), request, make_rider("lqr"), path), report)
    laps = lambda: [message["lap"] for message in told if "lap" in message]  # noqa: E731
    try:
        ride.start()
        ride.ask({"type": "pause", "on": True})
        servers.append(LiveServer(page_of, ride.ask, ride.status))
        servers[0].start()
        browser.get(servers[0].address)
        ride.ask({"type": "reset"})
        wait = WebDriverWait(browser, 20)
        kinds = lambda: [next(iter(message)) for message in told]  # noqa: E731
        wait.until(lambda _: kinds().count("reset") == 2 and "state" in kinds()[-kinds()[::-1].index("reset") :])
        wait.until(lambda b: "Go on" in b.find_element(By.CSS_SELECTOR, '[data-live="pause"]').text)
        before = len([message for message in told if "state" in message])
        browser.find_element(By.CSS_SELECTOR, '[data-live="step"]').click()
        wait.until(lambda _: len([message for message in told if "state" in message]) == before + 1)
        ActionChains(browser).send_keys(" ").perform()
        wait.until(lambda b: b.find_element(By.CSS_SELECTOR, '[data-live="pause"]').text == "Pause")
        wait.until(lambda b: b.execute_script("return +(document.querySelector('.view').dataset.states ?? 0)") > 3)
        ActionChains(browser).key_down(Keys.ARROW_LEFT).pause(0.05).key_up(Keys.ARROW_LEFT).perform()
        wait.until(lambda _: ride.status()["status"]["hands"])
        page = "return document.querySelector('.view').view.live."

        def ride_as_seen() -> None:  # who sees fewer pictures rides slower, again whenever the machine becomes busier
            rate = wait.until(lambda b: b.execute_script(page + "rate"))
            pace = min(1.0, rate * SimulatorConfig().control_period)
            if abs(pace / ride.status()["status"]["pace"] - 1.0) > 0.2:
                ride.ask({"type": "pace", "factor": max(pace, PACES[0])})

        ride_as_seen()
        browser.execute_script(RIDE_BY_KEYS)
        ridden_until(lambda: laps() and browser.execute_script(page + "ridden"), told, ride_as_seen)
        assert ride.status()["status"]["hands"]
        ride.ask({"type": "rider", "hands": False, "balance": True})
        ride.ask({"type": "pace", "factor": 10.0})
        ridden_until(lambda: len(laps()) >= 2, told)
        rate = browser.execute_script(page + "rate")
        print(f"{rate:.0f} frames a second")
        errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
        assert errors == []
    finally:
        ride.end()
        for server in servers:
            server.close()
    ride.check()
    recording = open_ride(path)
    assert [ride.course.name for ride in recording.rides] == ["small circle"] * 2  # before and after the restart
    told = settings_words(*ride.settings)
    assert told == ["a command every 50 ms", "engine pybullet", "steps of 1 ms"]
    assert recorded_settings(recording) == told
    last = recording.rides[-1]
    assert len(last.laps) >= 2
    by_hand, by_computer = last.laps[0], last.laps[-1]
    both = compare([by_hand, by_computer])
    assert {run.lap.number for run in both.runs} == {by_hand.number, by_computer.number}
    course_ridden = ride.course
    assert course_ridden is not None
    ghost = ghost_of(both, course_ridden)
    assert ghost is not None
    series, is_lap = ghost
    assert is_lap
    assert series.columns["time"][0] == pytest.approx(0.0, abs=0.06)
    assert ghost_of(both, Course.from_elements("ring", [Arc(8.0, 2.0 * np.pi)], closed=True)) is None
    errors_m = last.table()["lateral_error_m"].abs()
    assert errors_m.max() < 3.0
    assert threading.active_count() < 20


# ---- a ride of others -----------------------------------------------------------------------------------------------


def listeners() -> tuple[list[dict[str, Any]], list[LiveServer], Callable[[dict[str, Any]], None]]:
    """Messages of a ride so far, servers of its page, and what takes a message for both."""
    told: list[dict[str, Any]] = []
    servers: list[LiveServer] = []

    def report(message: dict[str, Any]) -> None:
        told.append(message)
        for server in servers:
            server.publish(message)

    return told, servers, report


@pytest.fixture
def ridden_by_others() -> Iterator[int]:
    """ROS domain in which a simulator is ridden by the policy node in lockstep, as fast as they can."""
    with DomainLease() as lease:
        simulator = {"course": "circle", "speed": 4.0}
        with (
            NodeProcess("bike_sim.ros.sim_node", simulator, lease.domain_id),
            NodeProcess("bike_policy.drive", {"policy": "lqr"}, lease.domain_id),
        ):
            yield lease.domain_id


@pytest.mark.ros
def test_a_simulator_that_runs_is_watched_paused_and_restarted(
    ridden_by_others: int, browser: webdriver.Chrome
) -> None:
    told, servers, report = listeners()

    def page(origin: str) -> str:
        assert watch.course is not None
        view, words = live_view(watch.course, watch.machine, False), settings_words(*watch.settings)
        return render_live_page(view, None, STATE_NAMES, False, origin, words)

    times = lambda: [message["state"][0] for message in told if "state" in message]  # noqa: E731
    watch = LiveWatch(ridden_by_others, "bike", report)
    try:
        watch.start()
        assert watch.course is not None
        assert (watch.machine, watch.course.name, watch.powered) == ("whipple", "circle", False)
        assert settings_words(*watch.settings) == ["a command every 50 ms", "engine pybullet", "steps of 1 ms"]
        servers.append(LiveServer(page, watch.ask, watch.status))
        servers[0].start()
        browser.get(servers[0].address)
        wait = WebDriverWait(browser, 30)
        header = browser.find_element(By.TAG_NAME, "header").text
        assert "a command every 50 ms · engine pybullet · steps of 1 ms · page by two-wheeler-lab" in header
        wait.until(lambda b: b.execute_script("return +(document.querySelector('.view').dataset.states ?? 0)") > 10)
        assert times() == sorted(times())
        assert not browser.find_elements(By.CSS_SELECTOR, ".pad, .live-bar input, .live-bar select, [data-live=step]")
        ActionChains(browser).send_keys(Keys.ARROW_LEFT).send_keys(" ").perform()
        wait.until(lambda b: b.find_element(By.CSS_SELECTOR, '[data-live="pause"]').text == "Go on")
        stands_at = still(times)
        watch.ask({"type": "input", "steering": 1.0, "throttle": 0.0})  # a watcher has no commands
        browser.find_element(By.CSS_SELECTOR, '[data-live="pause"]').click()
        wait.until(lambda _: times()[-1] > stands_at)
        assert len([message for message in told if "reset" in message]) == 1
        ActionChains(browser).send_keys("r").perform()
        wait.until(lambda _: len([message for message in told if "reset" in message]) == 2)
        again = max(place for place, message in enumerate(told) if "reset" in message)
        wait.until(lambda _: any("state" in message for message in told[again:]))
        assert next(message["state"][0] for message in told[again:] if "state" in message) < stands_at
        assert browser.get_log("browser") == []
    finally:
        watch.end()
        for server in servers:
            server.close()
    watch.check()


def still(times: Callable[[], list[float]]) -> float:
    """The last time of a ride that stands, s; fails if it goes on."""
    for _ in range(50):
        before = times()[-1]
        time.sleep(0.5)
        if times()[-1] == before:
            return before
    raise AssertionError("a paused ride goes on")


@pytest.mark.ros
def test_where_no_simulator_runs_it_is_told_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_watch, "START_TIMEOUT", 1.0)
    with DomainLease() as lease:
        watch = LiveWatch(lease.domain_id, "other", lambda _: None)
        with pytest.raises(NodeLost, match=f"no simulator at /other in ROS domain {lease.domain_id} within 1 s"):
            watch.start()
        watch.end()


@pytest.mark.ros
def test_race_is_ridden_by_keys_against_riders(browser: webdriver.Chrome, tmp_path: Path) -> None:
    """The page shows all machines; the last one is the computer's until a key is pressed, and the recording replays."""
    circuit = tmp_path / "oval.yaml"
    circuit.write_text(OVAL)
    race = RaceSettings(str(circuit), 1, entries_of(["one=r1", "two=r1", "own=r1"], "classical"), line=0.0)
    told, servers, report = listeners()

    path = tmp_path / "race.mcap"
    settings = LiveSettings(race_config(race), ResetRequest(course=str(circuit)), make_rider("classical"), path)
    ride = LiveRace(race, settings, lambda part: None, report)
    try:
        ride.start()
        assert ride.course is not None
        view = live_view(ride.course, "own, r1", True, others=["one", "two"])
        page = partial(render_live_page, view, "classical", state_names(True), True, others=STATE_NAMES)
        servers.append(LiveServer(page, ride.ask, ride.status))
        servers[0].start()
        browser.get(servers[0].address)
        wait = WebDriverWait(browser, 40)
        columns = """return document.querySelector('.view').view.series
          .map(one => [one.name, one.columns.time.length, one.columns.x.at(-1)])"""
        wait.until(lambda b: b.execute_script("return +(document.querySelector('.view').dataset.states ?? 0)") > 10)
        (own, *others) = browser.execute_script(columns)
        assert [name for name, *_ in (own, *others)] == ["you", "one", "two"]
        assert own[1] == others[0][1] == others[1][1]
        assert len({round(x, 1) for *_, x in (own, *others)}) == 3
        assert not ride.status()["status"]["hands"]
        ActionChains(browser).key_down(Keys.ARROW_UP).perform()
        wait.until(lambda _: ride.status()["status"]["hands"])
        begun = len(told)
        ridden_until(lambda: sum("state" in message for message in told[begun:]) > 60, told)
        ActionChains(browser).key_up(Keys.ARROW_UP).perform()
        errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
        assert errors == []
    finally:
        ride.end()
        for server in servers:
            server.close()
    ride.check()
    recorded = RecordedRace.read(path)
    assert (recorded.commands[:, 2, 1] == 1.0).sum() > 20, "the key was full throttle"
    assert recorded.replay() == (len(recorded.states), "")
