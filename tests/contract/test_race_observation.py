"""The observation of a race: bounds, mirror symmetry, memory, references, and its card."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bike_policy.contract.action import LINE_OFFSET, PACE, ActionColumn, ActionLayout
from bike_policy.contract.observation import (
    COMPACT,
    DESCRIPTOR,
    GUIDED,
    PROP_LAYOUT,
    RACE_LAYOUTS,
    RACE_TERMS,
    ObservationLayout,
    RideMemory,
    Rows,
)
from bike_policy.planning.reference import GRIPS, KEPT, OPEN, LineTable, ReferenceRows
from bike_policy.riders.racing import RaceInterface
from bike_sim.schema import LOOK, OPPONENT, SIGNALS, STATE
from bike_sim.vehicles.files import load_vehicle
from tests.circuits import circle

ALL = ObservationLayout("all", tuple(name for name in RACE_TERMS if name != "rates"))
MACHINE = np.linspace(-0.8, 0.8, len(DESCRIPTOR))
finite = st.floats(-1e3, 1e3)


def drawn(rng, count, width=12.0):
    """Return rows of made-up machines somewhere between limits, with points that run ahead."""
    state = rng.normal(size=(count, 10))
    look = rng.normal(size=(count, 12))
    look[:, 2] = rng.uniform(1.0, 90.0, count)
    look[:, 5] = rng.uniform(0.0, 4000.0, count)
    line = np.cumsum(rng.uniform(0.5, 20.0, (count, 20, 3)), axis=1) * [1.0, 0.1, 0.01]
    aside = np.array([0.0, width / 2, 0.0])
    points = np.stack([line, line + aside, line - aside], axis=1)
    points[:, :, :, 1] += rng.uniform(-3.0, 3.0, count)[:, None, None]
    signals = rng.normal(size=(count, len(SIGNALS)))
    circuit = rng.uniform(-2.0, 8.0, (count, 8))
    others = rng.normal(size=(count, 5, 5)) * [1.0, 30.0, 3.0, 10.0, 3.0]
    return Rows(state, look, np.zeros((count, 20)), signals, circuit, points, np.zeros(count, dtype=bool), others)


def mirrored(rows):
    points = rows.points[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    return rows._replace(
        state=rows.state * STATE.mirror_signs,
        look=rows.look * LOOK.mirror_signs,
        signals=rows.signals * SIGNALS.mirror_signs,
        circuit=rows.circuit[:, [1, 0, 3, 2, 4, 5, 6, 7]],
        points=points,
        opponents=rows.opponents[:, [0, 1, 3, 2, 4]] * OPPONENT.mirror_signs,
    )


def reference(seed=0, sign=1.0):
    rng = np.random.default_rng(seed)
    curvature, speed = sign * 0.01 * rng.normal(size=501), rng.uniform(15.0, 80.0, 501)
    curvature[-1], speed[-1] = curvature[0], speed[0]
    return LineTable(5.0, np.stack((curvature, speed), axis=1))


def memory_of(layout, rows, sign=1.0, actions=()):
    """Return the memory of rides that each follow a line of their own, after some actions."""
    count = len(rows.state)
    references = ReferenceRows(count)
    for row in range(count):
        references.begin(row, reference(row, sign))
    memory = RideMemory(
        rolls=np.tile(rows.state[:, [3]], layout.history),
        steers=rows.state[:, 4].copy(),
        actions=np.zeros((count, 2, 2)),
        guide=np.tile([0.3 * sign, 0.5, 0.7 * sign, -0.05], (count, 1)),
        vehicle=MACHINE,
        grip=np.tile([0.9, 0.95, 0.03], (count, 1)),
        push=np.full(count, 0.3 * sign),
        references=references,
    )
    for action in actions:
        memory.actions[:, 1] = memory.actions[:, 0]
        memory.actions[:, 0] = action
    return memory


@pytest.mark.parametrize("layout", [ALL, *RACE_LAYOUTS.values()], ids=lambda layout: layout.name)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_mirrored_ride_gives_the_mirrored_observation(layout, seed):
    rng = np.random.default_rng(seed)
    rows, actions = drawn(rng, 3), rng.uniform(-1.0, 1.0, (2, 3, 2))
    seen = layout.observe(rows, memory_of(layout, rows, actions=actions))
    other = mirrored(rows)
    memory = memory_of(layout, other, sign=-1.0, actions=actions * [-1.0, 1.0])
    np.testing.assert_allclose(
        layout.observe(other, memory), seen[:, layout.mirror_places] * layout.mirror_signs, atol=1e-6
    )


@pytest.mark.parametrize("layout", RACE_LAYOUTS.values(), ids=RACE_LAYOUTS)
def test_mirroring_twice_changes_nothing(layout):
    np.testing.assert_array_equal(layout.mirror_places[layout.mirror_places], np.arange(layout.size))
    np.testing.assert_array_equal(layout.mirror_signs * layout.mirror_signs[layout.mirror_places], np.ones(layout.size))


@given(data=st.data())
def test_every_number_lies_within_its_bounds(data):
    rows = drawn(np.random.default_rng(data.draw(st.integers(0, 1000))), 1)
    wild = rows._replace(
        state=data.draw(arrays(np.float64, (1, 10), elements=finite)),
        signals=data.draw(arrays(np.float64, (1, len(SIGNALS)), elements=finite)),
    )
    seen = ALL.observe(wild, memory_of(ALL, wild))
    assert seen.dtype == np.float32
    assert seen.shape == (1, ALL.size) == (1, len(set(ALL.names)))
    assert (np.abs(seen) <= ALL.high).all()


def test_a_machine_is_seen_the_same_alone_and_among_others():
    rng = np.random.default_rng(3)
    rows = drawn(rng, 7)
    together = ALL.observe(rows, memory_of(ALL, rows))
    for i in range(7):
        alone = Rows(*(part[i : i + 1] for part in rows))
        memory = memory_of(ALL, alone)
        memory.references.begin(0, reference(i))
        np.testing.assert_array_equal(ALL.observe(alone, memory)[0], together[i])


def test_decisions_are_remembered_newest_first_and_forgotten_with_the_ride():
    rows, line = drawn(np.random.default_rng(0), 1), circle(60.0, 1.0)
    interfaces = [RaceInterface(COMPACT, DIRECT, load_vehicle("panigale_v4r"), 0.02, 1) for _ in range(2)]
    for interface in interfaces:
        interface.begin(0, rows, line)
    interface, other = interfaces
    place = {name: i for i, name in enumerate(COMPACT.names)}
    interface.act(rows, np.array([[0.25, -0.5]]))
    later = rows._replace(state=rows.state * 0.5)
    interface.act(later, np.array([[0.75, 1.0]]))
    seen = interface.observe(later)[0]
    actions = [seen[place[name]] for name in ("steering_1", "throttle_1", "steering_2", "throttle_2")]
    assert actions == [0.75, 1.0, 0.25, -0.5]
    assert seen[place["roll_before_2"]] == pytest.approx(np.clip(rows.state[0, 3] / 1.2, -1, 1), abs=1e-6)
    other.restore(interface.state_dict())
    np.testing.assert_array_equal(other.observe(later)[0], seen)
    interface.begin(0, later, line)
    assert interface.observe(later)[0][place["steering_1"]] == 0.0


@given(progress=st.floats(-1e4, 1e5), share=st.floats(0.1, 2.0), cap=st.floats(1.0, 100.0))
def test_a_reference_is_sampled_linearly_around_the_lap(progress, share, cap):
    rows, plan = ReferenceRows(2), reference(5)
    rows.begin(0, reference(1))
    rows.begin(1, plan, share, cap)
    s = np.arange(501) * plan.spacing
    curvature, speed = rows.at(np.array([0.0, progress]))
    at = progress % 2500.0
    assert curvature[1] == pytest.approx(np.interp(at, s, plan.table[:, 0]), abs=1e-9)
    assert speed[1] == pytest.approx(min(cap, share * np.interp(at, s, plan.table[:, 1])), abs=1e-7)
    many, _ = rows.at(np.full((2, 4), progress))
    np.testing.assert_array_equal(many[1], np.full(4, curvature[1]))


@given(grip=st.floats(0.3, 1.3), place=st.floats(0.0, 1000.0))
def test_an_adaptive_reference_asks_for_the_speed_of_the_inferred_grip(grip, place):
    rows, plan = ReferenceRows(2, adaptive=True), reference(5)
    slower = plan.table[:, 1:] * (0.95, 0.9, 0.8)
    for row in range(2):
        rows.begin(row, plan._replace(table=np.hstack((plan.table, slower))))
    rows.grip[1] = grip
    curvature, speed = rows.at(np.full(2, place))
    assert curvature[0] == curvature[1]
    expected = np.interp(min(max(grip, 0.7), 1.0), GRIPS[::-1], (0.8, 0.9, 0.95, 1.0))
    assert speed[1] == pytest.approx(expected * speed[0])


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_however_many_lines_come_and_go_each_row_sees_its_own(seed):
    """Rows change lines, lines come back, and what nobody rides on is not kept for ever."""
    rng = np.random.default_rng(seed)
    rows, count = ReferenceRows(3), 2 * KEPT
    lines = [
        LineTable(5.0, np.tile((float(k), 1.0 + k), (size, 1))) for k, size in enumerate(rng.integers(3, 50, count))
    ]
    followed = [0, 1, 2]
    for row in range(3):
        rows.begin(row, lines[row])
    for line in (*range(3, count), *rng.integers(count, size=20).tolist()):
        row = int(rng.integers(1, 3))  # the first stays where it is
        rows.begin(row, lines[line])
        followed[row] = line
        curvature, speed = rows.at(rng.uniform(0.0, 1e4, 3))
        np.testing.assert_allclose(curvature, followed, rtol=1e-12)
        np.testing.assert_allclose(speed, 1.0 + np.array(followed), rtol=1e-12)
    assert len(rows.lines.samples) <= 50 * (KEPT + 1)


@pytest.mark.parametrize(("share", "cap"), [(0.0, OPEN), (1.0, -1.0)])
def test_a_reference_without_speed_is_refused(share, cap):
    with pytest.raises(ValueError, match="must be positive"):
        ReferenceRows(1).begin(0, reference(), share, cap)


DIRECT = ActionLayout((ActionColumn("lean_request", 0.95), ActionColumn("throttle_and_brake")))


@pytest.mark.parametrize(
    ("layout", "action", "vehicle", "message"),
    [
        (GUIDED, DIRECT, "panigale_v4r", "'guided' shows the guide's commands, and there is no guide"),
        (PROP_LAYOUT, DIRECT, "panigale_v4r", "'prop' is of paths; it cannot race"),
        (COMPACT, DIRECT, "whipple", "needs a superbike with tyres to plan a lap, and 'whipple' is none"),
        (
            GUIDED,
            ActionLayout((ActionColumn(LINE_OFFSET), ActionColumn(PACE))),
            "whipple",
            "needs a superbike with tyres to plan a lap, and 'whipple' is none",
        ),
    ],
)
def test_what_does_not_race_is_refused(layout, action, vehicle, message):
    with pytest.raises(ValueError, match=message):
        RaceInterface(layout, action, load_vehicle(vehicle), 0.02, 1)
