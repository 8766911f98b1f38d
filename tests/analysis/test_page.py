"""The report page in a browser: headless Chromium, driven through Selenium.

`make test` installs the browser. Who may not install it gets these tests skipped with the reason; root and CI do not.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image
from selenium import webdriver
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from bike_analysis import compare, open_ride
from bike_analysis.page.document import MISSING, SHORT, embed, page_shell, program_version
from bike_analysis.page.race_page import RaceFigures, Racer, write_race_page
from bike_analysis.page.ride_page import write_page
from bike_analysis.page.ride_view import panels_for, ride_view
from bike_analysis.page.view import (
    FAST_CHANNELS,
    PANELS,
    MapLine,
    Series,
    View,
    growing,
    view_html,
)
from bike_analysis.read.container import shown
from bike_analysis.report import analyze
from bike_sim.course.files import load_course

FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage"),
)
DESK = (1400, 1900)
PHONE = (390, 844)
HOUR = 360_000  # states at 100 Hz


# ---- columns as they travel -----------------------------------------------------------------------------------------


def unpacked(packed: dict[str, Any]) -> np.ndarray:
    """What the script does, in numpy."""
    import base64
    import zlib

    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed["data"])), dtype=np.uint8)
    zigzag = np.ascontiguousarray(planes.reshape(4, -1).T).view("<u4").ravel()
    steps = (zigzag >> 1).astype(np.int32) ^ -(zigzag & 1).astype(np.int32)
    with np.errstate(over="ignore"):
        multiples = np.cumsum(steps, dtype=np.int32)
    return np.where(multiples == MISSING, np.nan, multiples * packed["quantum"])


@given(
    values=hnp.arrays(float, st.integers(1, 300), elements=st.floats(-1e9, 1e9) | st.just(np.nan)),
    quantum=st.sampled_from([1e-4, 1e-3, 0.1]),
)
def test_embedded_columns_come_back_to_half_a_quantum(values: np.ndarray, quantum: float) -> None:
    packed = embed(values, quantum)
    back = unpacked(packed)
    np.testing.assert_array_equal(np.isnan(back), np.isnan(values))
    known = np.isfinite(values)
    rounding = 0.5 * packed["quantum"] * (1.0 + 1e-9) + 1e-12 * np.abs(values[known]).max(initial=0.0)
    assert np.all(np.abs(back - values)[known] <= rounding)
    assert packed["rows"] == len(values)
    with pytest.raises(ValueError, match="quantum"):
        embed(values, 0.0)


@given(values=hnp.arrays(float, st.integers(1, 50), elements=st.floats(-1e3, 1e3) | st.just(np.nan)))
def test_axes_never_fall_and_are_never_missing(values: np.ndarray) -> None:
    axis = growing(values)
    assert np.all(np.diff(axis) >= 0.0)
    assert np.all(np.isfinite(axis))


def test_places_off_the_track_are_marked_and_missing_places_are_not(writer: Any, circle: Any, tmp_path: Path) -> None:
    """0.3 m left of a line that has 0.25 m to its left limit, for the first hundred states."""
    offset = np.where(np.arange(300) < 100, 0.3, 0.2)
    ride = circle(steps=300, offset=offset)
    ride.states |= {"front_lateral_error": offset.copy(), "front_progress": ride.states["progress"]}
    ride.states["x"][7] = np.nan
    ride.course |= {side: np.full(len(ride.course["s"]), 0.25) for side in ("width_left", "width_right")}
    recording = open_ride(writer.write(tmp_path / "off.mcap", [ride]))
    data = ride_view(recording.rides[0], "off", "off").data()
    json.dumps(data, allow_nan=False)
    marks = {mark["name"]: mark for mark in data["marks"]}
    assert len(marks["off the track"]["x"]) == len(marks["off the track"]["y"]) == 99
    assert [line["role"] for line in data["lines"]] == ["reference", "limit", "limit"]


# ---- the browser ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def programs() -> tuple[str, str]:
    """Chromium and its driver."""
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        reason = "the page tests need the Debian packages chromium and chromium-driver, which `make test` installs"
        if os.geteuid() == 0 or os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(f"{reason} as root or with sudo")
    return chromium, driver


@pytest.fixture(scope="session")
def browser(programs: tuple[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = programs[0]
    for flag in FLAGS:
        options.add_argument(flag)
    options.add_argument(f"--user-data-dir={tmp_path_factory.mktemp('profile')}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(programs[1]))
    driver.set_script_timeout(60)
    yield driver
    driver.quit()


Opener = Callable[..., webdriver.Chrome]


@pytest.fixture
def opened(browser: webdriver.Chrome) -> Iterator[Opener]:
    """Opens a page at a size and in a scheme, and waits until its first view is drawn."""

    def open_page(path: Path, size: tuple[int, int] = DESK, dark: bool = False) -> webdriver.Chrome:
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
        metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size == PHONE}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        for kind in ("browser", "performance"):
            browser.get_log(kind)
        browser.get(path.as_uri())
        WebDriverWait(browser, 60).until(lambda d: d.find_elements(By.CSS_SELECTOR, ".view[data-ready]"))
        settled(browser)
        return browser

    yield open_page
    told = [entry for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")]
    errors = [
        entry for entry in told if "getImageData" not in entry["message"]
    ]  # the tests read pixels; the page does not
    browser.execute_script("localStorage.clear()")
    assert errors == []


@pytest.fixture(scope="module")
def ride_page(writer: Any, circle: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    offset = 0.2 + 0.15 * np.sin(0.05 * np.arange(400))
    path = writer.write(tmp_path_factory.mktemp("page") / "ride.mcap", [circle(steps=400, offset=offset)])
    return write_page([open_ride(path)], path.with_name("ride.html"))


@pytest.fixture(scope="module")
def comparison_page(writer: Any, circle: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compared")
    paths = [
        writer.write(folder / f"{name}.mcap", [circle(steps=steps, speed=speed)])
        for name, steps, speed in (("slow", 420, 4.0), ("fast", 420, 5.0))
    ]
    recordings = [open_ride(path) for path in paths]
    return write_page(recordings, folder / "both.html", compare(recordings))


def value_of(browser: webdriver.Chrome) -> int:
    return int(browser.find_element(By.CSS_SELECTOR, ".plot").get_attribute("aria-valuenow"))


def place_of(browser: webdriver.Chrome, selector: str) -> str:
    return browser.find_element(By.CSS_SELECTOR, selector).value_of_css_property("transform")


def settled(browser: webdriver.Chrome) -> None:
    """Waits until nothing is left to be drawn."""
    browser.execute_async_script("""
      const done = arguments[0];
      const views = [...document.querySelectorAll(".view")].map(section => section.view).filter(view => view.series);
      const idle = view => !view.asked && ![...view.dirty].some(part => part.seen);
      const look = () => views.every(idle) ? done() : requestAnimationFrame(look);
      requestAnimationFrame(() => requestAnimationFrame(look));""")


def inked_pixels(browser: webdriver.Chrome, where: str = "main") -> list[tuple[str, int]]:
    """Opaque pixels of each plot of a part of the page."""
    drawn = browser.execute_script(
        """
      const inked = f => new Uint32Array(canvasData(f).buffer).filter(pixel => pixel >>> 24 > 200).length;
      const canvasData = f => {
        const canvas = f.querySelector("canvas");
        return canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
      };
      const figures = document.querySelectorAll(`${arguments[0]} figure[data-plot]`);
      return [...figures].map(f => [f.dataset.plot, inked(f)])""",
        where,
    )
    return [(str(key), int(pixels)) for key, pixels in drawn]


def test_every_plot_is_drawn_and_nothing_is_asked_for(opened: Opener, ride_page: Path) -> None:
    browser = opened(ride_page)
    drawn = inked_pixels(browser)
    assert [key for key, _ in drawn] == ["follow", "map", "error", "lean", "speed", "command", "age"]
    assert all(pixels > 500 for _, pixels in drawn), drawn
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    # The browser's first tab, which a fresh profile opens before the page, may still be loading what is its own.
    sent = [m["params"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    asked = [params["request"]["url"] for params in sent if params["documentURL"] == ride_page.as_uri()]
    assert asked, "the performance log shows at least the page itself"
    assert not [url for url in asked if not url.startswith(("file:", "data:", "blob:"))]
    blocked = browser.execute_async_script("""const done = arguments[0];
      document.addEventListener("securitypolicyviolation", event => done(event.effectiveDirective));
      fetch("http://127.0.0.1:9/").catch(() => {});""")
    assert blocked == "connect-src", "the policy refuses requests"
    browser.get_log("browser")  # the refusal is told there
    for ticks, increment, texts in (
        ([5, 7.5, 10], 2.5, ["5.0", "7.5", "10.0"]),
        ([-0.25, 0.5], 0.25, ["−0.25", "0.50"]),
        ([0, 20], 20, ["0", "20"]),
        ([0.2, 0.4], 0.2, ["0.2", "0.4"]),
    ):
        values = "const { u } = document.querySelector('.view').view.parts.find(p => p.chart?.u?.axes[1].values).chart;"
        values += "return u.axes[1].values(u, arguments[0], 1, 0, arguments[1]);"
        assert browser.execute_script(values, ticks, increment) == texts


def test_the_header_is_one_line_of_words_for_each_recording(
    opened: Opener, ride_page: Path, comparison_page: Path
) -> None:
    (alone,) = opened(ride_page).find_elements(By.CSS_SELECTOR, "header > p")
    assert " messages · " in alone.text
    assert f" · page by {program_version()}" in alone.text
    lines = [line.text for line in opened(comparison_page).find_elements(By.CSS_SELECTOR, "header > p")]
    assert [line.partition(" · ")[0] for line in lines] == ["slow.mcap", "fast.mcap", f"page by {program_version()}"]


def test_a_recording_of_an_older_version_is_drawn(opened: Opener, old_recording: Path, tmp_path: Path) -> None:
    """Alone, and beside another ride of the course; `test_old_recordings.py` reads its figures."""
    analyze([old_recording], tmp_path / "alone")
    browser = opened(tmp_path / "alone" / "ride.html")
    drawn = inked_pixels(browser)
    assert [key for key, _ in drawn] == ["follow", "map", "error", "lean", "speed", "command", "age"]
    assert all(pixels > 500 for _, pixels in drawn), drawn
    words = browser.find_element(By.TAG_NAME, "header").text
    assert "a command every 50 ms" in words
    assert "engine" not in words, "it does not tell"
    again = shutil.copy(old_recording, tmp_path / "again.mcap")
    analyze([old_recording, again], tmp_path / "both")
    browser = opened(tmp_path / "both" / "ride.html")
    beside = inked_pixels(browser, "#comparison")
    assert {key for key, pixels in beside if pixels > 500} >= {"map", "error", "lean", "speed"}, beside
    assert not [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


CURSOR = """
  const view = document.querySelector(".view").view, { row } = view, { columns } = view.main;
  return Object.fromEntries(view.parts.filter(part => part.shows).map(part => {
    const kind = part.figure.dataset.plot, here = part.area.querySelector(".here");
    const k = part.lines?.findIndex(found => found.line.fill !== "band");
    const [x, y, dot] = {
      map: () => [columns.x[row], columns.y[row], here],
      cloud: () => [columns.lateral[row], columns.along[row], here],
    }[kind]?.() ?? [view.at, part.lines[k].column[row], part.points[k]];
    const { u } = part.chart, canvas = part.paper.querySelector("canvas"), paper = canvas.getBoundingClientRect();
    const box = dot.getBoundingClientRect();
    const off = [box.left + box.width / 2 - paper.left - u.valToPos(x, "x", true) / devicePixelRatio,
      box.top + box.height / 2 - paper.top - u.valToPos(y, "y", true) / devicePixelRatio];
    const fits = part.plot.clientWidth === u.width && part.plot.clientHeight === u.height
      && paper.width === u.width && paper.height === u.height;
    return [kind, { off: dot.hidden ? null : off, fits, seen: part.seen, size: [paper.width, paper.height] }];
  }));"""


def lap_page(path: Path) -> Path:
    """A circuit of a minute with map, g-g diagram and follow view; the first accelerations are unknown."""
    view = circuit_view(6000)
    columns = view.series[0].columns
    columns |= {"lateral": np.sin(columns["time"]), "along": 0.6 * np.cos(columns["time"])}
    columns["lateral"][:10] = np.nan
    edges = [(1.0 + 0.02 * k) * columns[name][::20] for k in (1, -1) for name in ("x", "y")]
    view = replace(
        view,
        cloud={
            **{"title": "g-g", "x": "lateral", "y": "along", "x_label": "lateral in g", "y_label": "longitudinal in g"},
            **{"box": (-1.0, 1.0, -0.6, 0.6), "caption": "", "limit": None},
        },
        follow={"title": "", "lapTime": "", "step": 8.0, "line": [], "edges": [edge.tolist() for edge in edges]},
    )
    return page_of(view, path)


def page_of(view: View, path: Path) -> Path:
    """Write a page of one view."""
    path.write_text(page_shell(view.title, "", [view_html(view)], [view]))
    return path


def resized(browser: webdriver.Chrome, size: tuple[int, int]) -> None:
    """Makes the window another size, and waits until it is drawn."""
    metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size == PHONE}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    inner = "return [document.documentElement.clientWidth, innerHeight]"
    WebDriverWait(browser, 10).until(lambda b: b.execute_script(inner) == list(size), f"the window is not {size}")
    settled(browser)


def assert_marks_lie_on_the_drawings(browser: webdriver.Chrome, *kinds: str) -> dict[str, Any]:
    """All plots on the screen come to fill their places, and then each mark is where uPlot has its state."""

    def filled(browser: webdriver.Chrome) -> dict[str, Any] | None:  # the browser tells late what is on the screen
        found: dict[str, Any] = browser.execute_script(CURSOR)
        seen = {kind: plot for kind, plot in found.items() if plot["seen"]}
        return seen if seen.keys() >= set(kinds) and all(plot["fits"] for plot in seen.values()) else None

    found: dict[str, Any] = WebDriverWait(browser, 10).until(filled, "a plot keeps another size than its place")
    for kind, plot in found.items():
        assert plot["off"] is not None, f"{kind} has its mark"
        assert np.abs(plot["off"]).max() <= 2.0, (kind, plot)
    return found


@pytest.mark.parametrize("dark", [False, True])
def test_the_cursor_lies_where_its_state_is_drawn(opened: Opener, tmp_path: Path, dark: bool) -> None:
    browser = opened(lap_page(tmp_path / "lap.html"), (1300, 3800), dark)
    hidden = "return document.querySelector('[data-plot=\"cloud\"] .here').hidden"
    assert browser.execute_script(hidden), "a missing place has no mark"
    browser.execute_script('document.querySelector(".view").view.setPlace(2222)')
    settled(browser)
    assert not browser.execute_script(hidden)
    resized(browser, (1300, 900))
    settled(browser)
    before = assert_marks_lie_on_the_drawings(browser, "map")
    resized(browser, (1300, 600))
    lower = assert_marks_lie_on_the_drawings(browser, "map")
    assert lower["map"]["size"][1] < before["map"]["size"][1], "the height alone changes the map's size"
    for size in ((1300, 3800), (1920, 1080), PHONE, (1300, 900)):
        resized(browser, size)
        assert_marks_lie_on_the_drawings(browser)
        browser.execute_script("""document.querySelector('[data-plot="cloud"]').scrollIntoView({block: "end"})""")
        settled(browser)
        assert_marks_lie_on_the_drawings(browser, "cloud")
        browser.execute_script("document.getElementById('theme').click(); scrollTo(0, 0)")
        settled(browser)
        assert_marks_lie_on_the_drawings(browser)
    assert browser.execute_script(CURSOR)["map"]["size"] == before["map"]["size"]


def test_hover_on_traces_and_map_moves_the_cursor_of_both(opened: Opener, ride_page: Path) -> None:
    browser = opened(ride_page)
    area = browser.find_element(By.CSS_SELECTOR, '[data-plot="error"] .area')
    seen = []
    for share in (-0.3, 0.0, 0.3):
        ActionChains(browser).move_to_element_with_offset(area, round(share * area.size["width"]), 0).perform()
        settled(browser)
        seen.append((value_of(browser), place_of(browser, ".map .here")))
    rows = [row for row, _ in seen]
    assert rows == pytest.approx([80, 200, 320], abs=3)  # the circle is ridden at constant speed
    assert len({place for _, place in seen}) == 3
    area = browser.find_element(By.CSS_SELECTOR, ".map .area")
    ActionChains(browser).move_to_element_with_offset(area, 0, -round(0.4 * area.size["height"])).perform()
    settled(browser)
    half_a_lap = np.pi * 10.0 / (4.0 * 0.05)  # the top of the circle is half a lap from the start at its bottom
    assert value_of(browser) == pytest.approx(half_a_lap, abs=6)
    cursor, width = browser.execute_script("""const a = document.querySelector('[data-plot="error"] .area');
      return [new DOMMatrix(getComputedStyle(a.querySelector(".cursor")).transform).e, a.clientWidth]""")
    assert cursor / width == pytest.approx(half_a_lap / 399, abs=0.02)
    shown = browser.find_element(By.CSS_SELECTOR, '[data-plot="error"] .legend b').text
    assert shown.endswith("m")


def test_keys_move_the_cursor_and_zoom(opened: Opener, ride_page: Path) -> None:
    browser = opened(ride_page)
    plot = browser.find_element(By.CSS_SELECTOR, '[data-plot="error"] .plot')
    assert plot.get_attribute("role") == "slider"
    assert "Distance to the path" in plot.get_attribute("aria-label")
    plot.send_keys(Keys.ARROW_RIGHT * 3)
    assert value_of_after(browser) == 6  # two rows a key, of 400
    plot.send_keys(Keys.END)
    assert value_of_after(browser) == 399
    assert "19.95" in plot.get_attribute("aria-valuetext")
    plot.send_keys(Keys.HOME, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert value_of_after(browser) == 0
    whole = shown_range(browser)
    plot.send_keys("+")
    settled(browser)
    low, high = shown_range(browser)
    assert high - low == pytest.approx((whole[1] - whole[0]) / 1.5)
    plot.send_keys("0")
    assert shown_range(browser) == whole


def value_of_after(browser: webdriver.Chrome) -> int:
    settled(browser)
    return value_of(browser)


def shown_range(browser: webdriver.Chrome) -> list[float]:
    return browser.execute_script('return document.querySelector(".view").view.range')


def test_focus_goes_from_control_to_control_and_is_seen(opened: Opener, ride_page: Path) -> None:
    browser = opened(ride_page)
    met = []
    for _ in range(40):
        ActionChains(browser).send_keys(Keys.TAB).perform()
        here = browser.switch_to.active_element
        if here.get_attribute("class") == "plot":
            met.append(here.find_element(By.XPATH, "..").get_attribute("data-plot"))
            assert here.value_of_css_property("outline-style") == "solid"
        elif here.tag_name == "button":
            assert here.accessible_name
    assert met[:6] == ["map", "error", "lean", "speed", "command", "age"]


def test_a_dragged_stretch_is_zoomed_into_on_all_traces(opened: Opener, ride_page: Path) -> None:
    browser = opened(ride_page)
    area = browser.find_element(By.CSS_SELECTOR, '[data-plot="speed"] .area')
    width = area.size["width"]
    drag = ActionChains(browser).move_to_element_with_offset(area, -width // 4, 0).click_and_hold()
    drag.move_by_offset(width // 4, 0).release().perform()
    settled(browser)
    low, high = shown_range(browser)
    whole = 399 * 0.05 * 4.0
    assert (low, high) == pytest.approx((0.25 * whole, 0.5 * whole), abs=0.01 * whole)
    ends = browser.execute_script("""return ["error", "age"].map(key => {
      const { x } = document.querySelector(`[data-plot=${key}]`).drawn.chart.u.scales; return [x.min, x.max]; })""")
    assert ends == [[low, high], [low, high]]
    browser.find_element(By.CSS_SELECTOR, 'input[value="time"]').send_keys(Keys.SPACE)
    settled(browser)
    assert shown_range(browser) == pytest.approx([low / 4.0, high / 4.0], abs=0.1), "over time the stretch is kept"


@pytest.mark.parametrize("page", ["ride_page", "comparison_page"])
def test_a_phone_needs_no_horizontal_scrolling(opened: Opener, page: str, request: pytest.FixtureRequest) -> None:
    browser = opened(request.getfixturevalue(page), PHONE)
    assert browser.execute_script("return [innerWidth, document.documentElement.scrollWidth]") == [390, 390]
    cut = browser.execute_script("""
      const tables = [...document.querySelectorAll(".scroll")];
      return tables.filter(table => table.scrollWidth > table.clientWidth).map(table => table.innerText);""")
    assert cut == []


def test_a_finger_moves_the_cursor_and_two_zoom(opened: Opener, ride_page: Path) -> None:
    browser = opened(ride_page, PHONE)
    browser.execute_script("""document.querySelector('[data-plot="error"]').scrollIntoView({block: "end"})""")
    settled(browser)  # else a touch meets what was there before
    box = browser.execute_script("""
      const b = document.querySelector('[data-plot="error"] .area').getBoundingClientRect();
      return [b.left, b.top, b.width, b.height]""")

    def touch(kind: str, *shares: float) -> None:
        points = [{"x": box[0] + share * box[2], "y": box[1] + 0.5 * box[3], "id": k} for k, share in enumerate(shares)]
        browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", 0.5)
    touch("touchMove", 0.75)
    touch("touchEnd")
    wait = WebDriverWait(browser, 10)  # the browser hands touches on when it comes to it
    wait.until(lambda _: value_of(browser) == pytest.approx(0.75 * 399, abs=4))
    low, high = shown_range(browser)
    touch("touchStart", 0.4, 0.6)
    for spread in (0.15, 0.2, 0.3):
        touch("touchMove", 0.5 - spread, 0.5 + spread)
    touch("touchEnd")
    wait.until(lambda _: 0.25 < np.ptp(shown_range(browser)) / (high - low) < 0.45)  # three times as wide apart


INK = """
  const { chart } = document.querySelector(`[data-plot="${arguments[0]}"]`).drawn, { canvas } = chart.u.ctx;
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height), count = new Map();
  for (let k = 0; k < data.length; k += 4) {
    const [r, g, b, alpha] = data.slice(k, k + 4);
    if (alpha > 250 && Math.max(r, g, b) - Math.min(r, g, b) > 60) {
      count.set(`${r},${g},${b}`, (count.get(`${r},${g},${b}`) ?? 0) + 1);
    }
  }
  return [...count].sort((a, b) => b[1] - a[1])[0][0];"""
"""The colour that most pixels of a plot's line have."""


def test_dark_and_light_differ_and_the_reader_chooses(opened: Opener, ride_page: Path) -> None:
    looks = {}
    for dark in (False, True):
        browser = opened(ride_page, dark=dark)
        body = browser.find_element(By.TAG_NAME, "body")
        looks[dark] = (body.value_of_css_property("background-color"), browser.execute_script(INK, "error"))
    assert looks[False][0] != looks[True][0]
    assert looks[False][1] != looks[True][1]
    browser.find_element(By.TAG_NAME, "body").send_keys("t")
    settled(browser)
    assert browser.execute_script(INK, "error") == looks[False][1]
    assert browser.find_element(By.ID, "theme").get_attribute("aria-pressed") == "false"


def test_plots_are_saved_as_pictures_in_which_names_are_no_tags(
    opened: Opener, writer: Any, circle: Any, tmp_path: Path
) -> None:
    name, ride = "&lt;a <b>bold</b> <a href='#'>link</a>", circle(steps=200)
    ride.course["name"] = name
    browser = opened(write_page([open_ride(writer.write(tmp_path / "ride.mcap", [ride]))], tmp_path / "page.html"))
    browser.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(tmp_path)})
    assert not browser.find_elements(By.CSS_SELECTOR, "main b b, main a[href='#']")
    for plot in ("error", "map"):
        browser.find_element(By.CSS_SELECTOR, f'[data-plot="{plot}"] [data-save]').click()
        WebDriverWait(browser, 30).until(lambda _, plot=plot: [*tmp_path.glob(f"*-{plot}.png")])
        png = next(tmp_path.glob(f"*-{plot}.png"))
        WebDriverWait(browser, 30).until(lambda _, png=png: png.stat().st_size)
        with Image.open(png) as image:
            assert image.width >= 1600
            drawn = np.asarray(image.convert("RGB").reduce(2), dtype=int)
        assert len(np.unique(drawn[::2].reshape(-1, 3), axis=0)) > 50
        head = drawn[:20]  # the title
        assert np.abs(head - head[0, 0]).max(axis=2).any()


def test_compared_rides_have_ghosts_and_can_be_hidden(opened: Opener, comparison_page: Path) -> None:
    browser = opened(comparison_page)
    view = browser.find_element(By.ID, "comparison-view")
    assert [f.get_attribute("data-plot") for f in view.find_elements(By.TAG_NAME, "figure")][:4] == [
        *("follow", "map", "speed", "delta")
    ]
    browser.execute_script('document.querySelector(".view").view.setPlace(150)')
    settled(browser)
    lost = float(view.find_elements(By.CSS_SELECTOR, '[data-plot="delta"] .legend b')[1].text.split("\u202f")[0])
    way = 150 * 0.05 * 5.0
    assert lost == pytest.approx(way / 4.0 - way / 5.0, abs=0.03)
    here, ghost = browser.execute_script("""return ["here", "ghost"].map(name => {
      const place = new DOMMatrix(getComputedStyle(document.querySelector(`.map .${name}`)).transform);
      return [place.e, place.f]; })""")
    assert np.hypot(here[0] - ghost[0], here[1] - ghost[1]) > 20.0  # 7.5 m behind after 7.5 s, on a circle of 20 m
    other = view.find_elements(By.CSS_SELECTOR, ".series button")[1]
    lines = "return document.querySelector('[data-plot=\"speed\"]').drawn.chart.u.series.length - 1"
    assert browser.execute_script(lines) == 2
    other.click()
    settled(browser)
    assert other.get_attribute("aria-pressed") == "false"
    assert browser.execute_script(lines) == 1


OWN_CLOCK = """
  const waiting = [];
  let now = 0;
  window.requestAnimationFrame = action => waiting.push(action);
  window.pass = milliseconds => { now += milliseconds; for (const action of waiting.splice(0)) action(now); };"""
"""Frames come only when the test lets time pass."""


def after(browser: webdriver.Chrome, seconds: float, frames: int) -> int:
    """Where the cursor stands once the page's clock has gone on; what the last frame asks for is drawn."""
    browser.execute_script(
        "for (let k = 0; k < arguments[1]; k++) pass(arguments[0] / arguments[1])", 1e3 * seconds, frames
    )
    browser.execute_script("pass(0)")
    return value_of(browser)


def test_playing_moves_the_cursor_at_the_pace_of_the_ride(opened: Opener, ride_page: Path) -> None:
    """By a clock of the test's own: how soon a busy machine draws does not matter, only what time a frame is of."""
    browser = opened(ride_page)
    browser.execute_script(OWN_CLOCK)
    plot = browser.find_element(By.CSS_SELECTOR, ".plot")
    browser.execute_script('document.querySelector("select.rate").value = "4"')
    button = browser.find_element(By.CSS_SELECTOR, '[data-do="play"]')
    button.click()
    assert button.text == "Pause"
    after(browser, 0, frames=1)
    for frames in (10, 40):
        begins = value_of(browser)
        moved = after(browser, 1.0, frames) - begins
        assert moved == pytest.approx(4.0 / 0.05, abs=1), "four seconds of the ride in one, at any rate of frames"
    button.click()
    assert button.text == "Play"
    stands = value_of(browser)
    assert after(browser, 1.0, frames=20) == stands
    button.click()
    assert after(browser, 20.0, frames=100) == int(plot.get_attribute("aria-valuemax"))
    assert button.text == "Play", "it stops at the end"


def test_print_is_light(opened: Opener, ride_page: Path) -> None:
    script = f"""const line = function () {{ {INK} }};
      dispatchEvent(new Event("beforeprint"));
      const printed = line.apply(null, arguments);
      dispatchEvent(new Event("afterprint"));
      return printed;"""
    light = opened(ride_page).execute_script(script, "error")
    browser = opened(ride_page, dark=True)
    assert browser.execute_script(script, "error") == light
    settled(browser)
    assert browser.execute_script(INK, "error") != light


def test_names_do_not_break_the_page(
    opened: Opener, writer: Any, circle: Any, tmp_path: Path, evil_names: tuple[str, ...]
) -> None:
    """Names that would end the script, begin another or be taken for tags, of everything that has a name."""
    elements = """return [document.querySelectorAll(".view").length, document.scripts.length,
      document.querySelectorAll("main img, main script, main h2 b, main td b, [onclick], [onerror]").length]"""
    paths = []
    for names in (evil_names[:1], evil_names[1:7], evil_names[7:]):  # the first by itself: others would mend it
        rides = []
        for number, evil in enumerate(names):
            ride = circle(steps=170, episode=number, events=[{"step": 165, "kind": 2, "text": evil}])
            ride.course |= {"name": evil, "section_names": [evil, f"{evil} again"]}
            ride.states["vehicle"] = np.full(170, evil)
            rides.append(ride)
        paths.append(writer.write(tmp_path / f"<b>&{len(paths)}.mcap", rides, metadata_file=False))
        browser = opened(write_page([open_ride(paths[-1])], tmp_path / "page.html"), (600, 400))
        assert browser.execute_script(elements) == [len(names), 3, 0]
        assert "<b>&" in browser.find_element(By.TAG_NAME, "h1").text
        cells = browser.execute_script("return [...document.querySelectorAll('td')].map(cell => cell.textContent)")
        assert {f"1\u2002{shown(evil)}" for evil in names} <= set(cells)
    recordings = [open_ride(path) for path in paths]
    both = [recording.rides[0] for recording in recordings]
    browser = opened(write_page(recordings, tmp_path / "page.html", compare(both)), (1200, 1000))
    assert browser.execute_script(elements)[1:] == [3, 0]


def test_long_notes_are_folded_and_say_whose_they_are(writer: Any, circle: Any, tmp_path: Path) -> None:
    paths = [tmp_path / folder / "<ride>.mcap" for folder in ("a", "b")]
    for path, task in zip(paths, ("first", "second"), strict=True):
        path.parent.mkdir()
        notes = {"policy": "short", "task": f"{task} <b>{'x' * SHORT}"}
        writer.write(path, [circle(steps=50)], notes=notes, metadata_file=False)
    recordings = [open_ride(path) for path in paths]
    folded = re.compile(
        "<summary>More notes of ([^<]*)</summary><dl class=keys><dt>task</dt><dd>(first|second) &lt;b&gt;x"
    )
    page = write_page(recordings, tmp_path / "page.html")
    assert folded.findall(page.read_text()) == [
        ("a/&lt;ride&gt;.mcap", "first"),
        ("b/&lt;ride&gt;.mcap", "second"),
    ]
    assert folded.findall(write_page(recordings[:1], page).read_text()) == [("the recording", "first")]


def test_poor_rides_are_drawn_as_far_as_they_go(opened: Opener, writer: Any, circle: Any, tmp_path: Path) -> None:
    """One state; two; no course and no optional fields; a fall."""
    rides = [circle(steps=n, episode=k, start_s=10.0 * k) for k, n in enumerate((1, 2, 50, 50), start=1)]
    for name in ("speed", "roll", "yaw", "curvature", "steering_command", "progress"):
        rides[2].states[name] = np.full(50, np.nan)
    rides[2].course = None
    rides[3].states["fallen"] = np.arange(50) >= 49
    path = writer.write(tmp_path / "poor.mcap", rides)
    browser = opened(write_page([open_ride(path)], tmp_path / "poor.html"))
    opening = (
        "Promise.all([...document.querySelectorAll('.view')].map(section => section.view.open())).then(arguments[0])"
    )
    browser.execute_async_script(opening)
    browser.find_element(By.CSS_SELECTOR, "#ride-4").location_once_scrolled_into_view  # noqa: B018
    drawn = "return [...document.querySelectorAll('#ride-4 figure')].filter(figure => figure.drawn.chart?.u).length"
    # A busy browser says what is in sight later than in the two frames that `settled` waits for.
    WebDriverWait(browser, 30).until(lambda b: b.execute_script(drawn) > 3)
    figures = browser.find_elements(By.CSS_SELECTOR, "#ride-3 figure")
    assert [figure.get_attribute("data-plot") for figure in figures] == ["map", "error", "lean", "command"]


# ---- many rows ------------------------------------------------------------------------------------------------------


def test_extremes_of_any_stretch_are_among_what_is_drawn(opened: Opener, tmp_path: Path) -> None:
    """All lines, also where a part of the values is missing."""
    view = circuit_view(60_000)
    columns = view.series[0].columns
    columns["roll"][5_000:25_000] = np.nan
    columns["steer"][::3] = np.nan
    path = page_of(view, tmp_path / "extremes.html")
    rng = np.random.default_rng(7)
    end = float(columns["distance"][-1])
    stretches = [sorted(rng.uniform(0.0, end, 2)) for _ in range(15)]
    widths = 10.0 ** rng.uniform(0.5, 4.0, 15)
    stretches += [[low, low + width] for low, width in zip(rng.uniform(0.0, end, 15), widths, strict=True)]
    found = opened(path).execute_script(
        """
      const view = document.querySelector(".view").view, panels = view.parts.filter(part => part.spec);
      const extremes = values => values.reduce(([low, high], value) => value === value
        ? [Math.min(low, value), Math.max(high, value)] : [low, high], [Infinity, -Infinity]).map(String);
      return arguments[0].flatMap(([low, high]) => {
        view.setRange(low, high);
        return panels.flatMap(part => {
          const { found, y: [foot, top] } = part.wanted(800, 168);
          return found.map(line => [`${line.line.column} from ${low} to ${high} m`, line.y.length,
            extremes(line.column.slice(line.first, line.end)), extremes(line.y),
            line.y.every(y => !(y < foot || y > top))]);
        });
      });""",
        stretches,
    )
    assert len(found) > 250
    assert max(points for _, points, *_ in found) > 1000
    for where, points, wanted, drawn, inside in found:
        assert drawn == wanted, where
        assert inside, where
        assert points < 4 * 800, where


def test_the_map_follows_pan_and_zoom(opened: Opener, tmp_path: Path) -> None:
    """What is drawn moves with the fingers: the box in the middle of a dark line, and the mark on it."""
    browser = opened(lap_page(tmp_path / "lap.html"), (1300, 3800))
    ends = browser.execute_script("""const view = document.querySelector(".view").view;
      view.active = view.parts.find(part => part.spec?.key === "error");
      view.zoom(0.4, 700); view.frame();
      const { x } = view.active.chart.u.scales, ends = [[x.min, x.max], view.range];
      view.setRange(...view.whole()); view.frame();
      return ends;""")
    assert ends[0] == ends[1], "a zoom is drawn in the frame that asks for it"
    resized(browser, (1300, 900))
    places = """const view = document.querySelector(".view").view, part = view.parts.find(part => part.bounds);
      %s
      const { canvas } = part.chart.u.ctx;
      const { data, width } = part.chart.u.ctx.getImageData(0, 0, canvas.width, canvas.height);
      const seen = [...Array(data.length / 4).keys()].filter(k => data[4 * k + 3] > 250);
      const across = seen.map(k => k %% width), down = seen.map(k => Math.floor(k / width));
      const ends = list => list.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
      const box = part.plot.querySelector(".here").getBoundingClientRect(), area = part.plot.getBoundingClientRect();
      return [ends(across), ends(down), [box.left + box.width / 2 - area.left, box.top + box.height / 2 - area.top]];"""
    across, down, dot = browser.execute_script(places % "")
    pan = "const metre = part.width / (part.box[1] - part.box[0]); part.look(-8 / metre, 6 / metre, 1); view.frame();"
    panned_across, panned_down, panned_dot = browser.execute_script(places % pan)
    assert np.subtract(panned_across, across) == pytest.approx([8.0, 8.0], abs=1.5)
    assert np.subtract(panned_down, down) == pytest.approx([6.0, 6.0], abs=1.5)
    assert np.subtract(panned_dot, dot) == pytest.approx([8.0, 6.0], abs=0.5)
    shrink = "part.zoomAt(1.25, [100, 100]); view.frame();"
    zoomed_across, zoomed_down, zoomed_dot = browser.execute_script(places % shrink)
    assert np.ptp(zoomed_across) == pytest.approx(np.ptp(panned_across) / 1.25, abs=4.0)
    assert np.ptp(zoomed_down) == pytest.approx(np.ptp(panned_down) / 1.25, abs=4.0)
    assert np.subtract(zoomed_dot, 100) == pytest.approx(np.subtract(panned_dot, 100) / 1.25, abs=0.5)


def test_differences_are_to_the_reference_that_is_chosen(opened: Opener, tmp_path: Path) -> None:
    """Laps of 1 km at 20, 25 and 40 m/s: at 500 m the first has lost 5 s on the second and 12.5 s on the third."""
    way = np.linspace(0.0, 1000.0, 2001)
    series = tuple(
        Series(name, {"distance": way, "time": way / v, "speed": np.full(2001, v), "x": way, "y": 0.0 * way})
        for name, v in (("slow", 20.0), ("middle", 25.0), ("fast", 40.0))
    )
    panels = tuple(PANELS[name] | {"bands": ("aid",)} for name in ("delta", "speed_delta"))
    bins = {"edges": (0.0, 30.0, 60.0), "shares": {"slow": (60.0, 40.0), "fast": (0.0, 100.0)}}
    view = View(
        *("laps", "laps", series, panels),
        bands=({"key": "aid", "name": "an aid", "colour": "aid1", "rows": ((200, 400),)},),
        histograms=({"key": "lean-histogram", "title": "Lean", "label": "lean in °", "caption": "", **bins},),
        reference=2,
    )
    path = page_of(view, tmp_path / "laps.html")
    browser = opened(path)
    browser.execute_script('document.querySelector(".view").view.setPlace(1000)')
    settled(browser)

    def told(key: str) -> list[str]:
        figures = (By.CSS_SELECTOR, f'[data-plot="{key}"] .legend b')
        values = WebDriverWait(browser, 10).until(
            lambda b: b.find_elements(*figures)
        )  # drawn once it is known to be seen
        return [value.text.replace("\u2212", "-").split("\u202f")[0] for value in values]

    assert [float(value) for value in told("delta")] == pytest.approx([12.5, 7.5, 0.0])
    assert [float(value) for value in told("speed_delta")] == pytest.approx([-20.0, -15.0, 0.0])
    choice = browser.find_element(By.CSS_SELECTOR, "select.reference")
    choice.send_keys("middle")
    settled(browser)
    assert [float(value) for value in told("delta")] == pytest.approx([5.0, 0.0, -7.5])
    shown = browser.execute_script("""const { chart } = document.querySelector('[data-plot="lean-histogram"]').drawn;
      return [chart.u.series.length - 1, chart.wanted.found.map(one => one.y)]""")
    assert shown == [2, [[0, 60, 60, 40, 0], [0, 0, 0, 100, 0]]]
    strip = browser.execute_script("""const { u } = document.querySelector('[data-plot="delta"]').drawn.chart;
      const ink = getComputedStyle(document.documentElement).getPropertyValue("--aid1").trim();
      const foot = u.bbox.top + u.bbox.height - 4;
      const at = place => [...u.ctx.getImageData(u.valToPos(place, "x", true), foot, 1, 1).data].slice(0, 3)
       .map(part => part.toString(16).padStart(2, "0")).join("");
      return [ink.slice(1), at(150), at(50), at(250)];""")
    assert strip[0] == strip[1]
    assert strip[0] not in strip[2:]


def test_controls_and_rider_stay_in_sight_on_a_phone(opened: Opener, tmp_path: Path) -> None:
    browser = opened(lap_page(tmp_path / "lap.html"), PHONE)
    browser.execute_script("scrollTo(0, 1400)")
    settled(browser)
    tops = browser.execute_script("""return [".transport", ".follow"].map(name => {
      const { top, bottom } = document.querySelector(name).getBoundingClientRect(); return [top, bottom]; })""")
    assert (
        browser.execute_script("return scrollY") > 1300
    )  # the browser keeps in place what is seen, as plots get drawn
    assert all(0 <= top < bottom < 500 for top, bottom in tops), tops
    assert browser.execute_script("return [innerWidth, document.documentElement.scrollWidth]") == [390, 390]


# ---- an hour --------------------------------------------------------------------------------------------------------


def circuit_view(rows: int) -> View:
    """A machine on a circuit at 100 Hz, with a spike of one state in the error."""
    rng = np.random.default_rng(1)
    time_s = 0.01 * np.arange(rows)
    speed = 150.0 + 80.0 * np.sin(time_s / 9.0)
    way = np.cumsum(speed / 3.6 * 0.01)
    angle = way / 700.0

    def noise(size: float) -> np.ndarray:
        return size * np.convolve(rng.normal(size=rows), np.full(20, 0.05), mode="same")

    error = noise(0.3)
    error[rows // 3] = 7.0
    columns = {
        **{"distance": way, "time": time_s, "yaw": angle, "error": error, "speed": speed + noise(2.0)},
        "x": 600.0 * np.sin(angle) + 150.0 * np.sin(3.0 * angle) + noise(0.5),
        "y": 400.0 * np.cos(angle) + noise(0.5),
        "roll": 40.0 * np.sin(2.0 * angle) + noise(2.0),
        "steer": noise(5.0),
        "balance": 40.0 * np.sin(2.0 * angle),
        "throttle": np.clip(100.0 * np.sin(time_s / 4.0) + noise(20.0), -100.0, 100.0),
        "command": noise(1.0),
        "reached": noise(1.0),
        "age": (rng.random(rows) < 0.01).astype(float),
    }
    path = MapLine("reference path", "reference", columns["x"][:6000], columns["y"][:6000])
    sections = tuple(
        {"label": str(k % 12 + 1), "name": "a section", "first": 1000 * k, "last": 1000 * (k + 1), "shaded": False}
        for k in range(rows // 1000 - 1)
    )
    return View(
        *("circuit", "a circuit", (Series("ride", columns),), panels_for(columns, fast=True), (path,)),
        sections=sections,
        colours=("error", "speed"),
        channels=FAST_CHANNELS,
    )


def test_an_hour_at_100_hz_loads_and_zooms(opened: Opener, tmp_path: Path) -> None:
    view = circuit_view(HOUR)
    path = page_of(view, tmp_path / "hour.html")
    assert path.stat().st_size < 30e6
    nothing = Series("none", {"time": np.zeros(1), "distance": np.zeros(1)})
    bare = page_of(replace(view, series=(nothing,), lines=()), tmp_path / "bare.html")
    assert bare.stat().st_size < 1e6, "what a page has besides its data"
    browser = opened(path)
    peak = browser.execute_script('return document.querySelector(".view").view.parts[1].shows.y[1]')
    assert peak >= 7.0, "the spike of one state is not thinned away"
    drawn = """const { view } = document.querySelector(".view");
      return view.parts.flatMap(part => part.lines ?? []).map(line => line.x.length)"""
    for when in ("what is drawn goes by pixels, not by states", "after zooming as well"):
        assert 100 < max(browser.execute_script(drawn)) < 8 * DESK[0], when
        browser.execute_script("""const view = document.querySelector(".view").view;
          for (let step = 0; step < 40; step++) { view.zoom(step < 20 ? 0.7 : 1 / 0.7, 70000); view.frame(); }""")
        settled(browser)


def test_race_is_seen_from_behind_any_machine(opened: Opener, tmp_path: Path) -> None:
    """The cursor goes to the chosen machine at the same time; who is out ends with a cross and leaves the map.

    Contacts are marked in the traces of those that touched, as long as they race.
    """
    circuit = replace(load_course("circle"), width_left=None, width_right=None)
    racers = []
    for place, (name, speed, rows) in enumerate((("first", 5.0, 400), ("second", 4.0, 200)), start=1):
        time = 0.05 * np.arange(rows)
        there = np.interp(speed * time, circuit.s, np.arange(len(circuit.s))).astype(int)
        zeros = np.zeros(rows)
        columns = {"time": time, "distance": speed * time, "x": circuit.x[there], "y": circuit.y[there],
                   "yaw": circuit.heading[there], "roll": zeros, "steer": zeros, "speed": zeros + speed}  # fmt: skip
        racers.append(Racer(name, place, columns, "" if place == 1 else "fell", [9.0, 11.0]))
    line = {"vehicle": "v", "rider": "r", "laps": 1, "penalty_s": 0.0, "best_lap_s": None, "passes": 0, "contacts": 0}
    result = [
        line | {"position": k, "name": racer.name, "grid": k, "time_s": 20.0, "end": racer.end or "finished"}
        for k, racer in enumerate(racers, start=1)
    ]
    gaps = [(1, 1, "first", 0.0), (1, 1, "second", 1.0), (1, 2, "first", 0.0)]
    figures = RaceFigures("race", result, gaps, [(1.0, "something")], racers, circuit, False)
    browser = opened(write_race_page(figures, tmp_path / "race.html"))
    assert all(pixels > 300 for _, pixels in inked_pixels(browser))
    assert len(browser.find_elements(By.CSS_SELECTOR, 'svg[aria-label="Positions"] path')) == 1
    moments = browser.execute_script("return document.querySelector('.view').view.spec.moments")
    assert [(moment["series"], moment["row"], moment["label"]) for moment in moments] == [
        (0, 180, "contact"), (0, 220, "contact"), (1, 180, "contact"), (1, 199, "fell"),
    ]  # fmt: skip
    state = (
        "const { view } = document.querySelector('.view'); return [view.main.name, view.main.columns.time[view.row]]"
    )
    browser.execute_script("document.querySelector('.view').view.setPlace(100)")
    assert browser.execute_script(state) == ["first", pytest.approx(5.0)]
    browser.find_element(By.CSS_SELECTOR, "select.leader option:nth-child(2)").click()
    settled(browser)
    assert browser.execute_script(state) == ["second", pytest.approx(5.0)]
    browser.find_element(By.CSS_SELECTOR, "select.leader option:nth-child(1)").click()
    browser.execute_script("document.querySelector('.view').view.setPlace(399)")
    settled(browser)
    row = "const { view } = document.querySelector('.view'); return view.rowIn(view.series[1], 'time')"
    assert browser.execute_script(row) == -1
