"""Machines that meet: slipstream, touches, hits, fallen machines in the way, who is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bike_sim.schema import GRAVITY, OPPONENT_SLOTS, SIGNALS
from bike_sim.sim import look as lk
from bike_sim.sim import traffic as tr
from bike_sim.sim.batch import Batch
from bike_sim.sim.config import superbike_config
from bike_sim.sim.request import ResetRequest

CONFIG = replace(superbike_config("panigale_v4r"), engine="compiled")
STRAIGHT = 300.0
"""Place on Barcelona's straight, m."""
COLUMNS = tr.INCIDENT.names


def placed(starts: list[tuple[float, float, float, float]], together: bool = True) -> Batch:
    """Return machines at places ahead (m) and beside (m) with headings (rad) and speeds (m/s)."""
    batch = Batch(len(starts), CONFIG, together=together)
    for row, (ahead, beside, heading, speed) in enumerate(starts):
        place = {"progress": STRAIGHT + ahead, "start_offset": beside, "start_heading": heading}
        batch.reset(row, ResetRequest(course="barcelona", line=0.0, speed_range=(speed, speed), **place))
    if together:
        batch.meet()
    return batch


def step(batch: Batch, throttle: float = 0.0) -> list[dict[str, float]]:
    batch.step(np.tile([0.0, throttle], (batch.count, 1)))
    return [dict(zip(COLUMNS, row, strict=True)) for row in batch.incidents]


def kinetic(batch: Batch) -> float:
    """Energy of the bodies as the others meet them, J."""
    assert batch.traffic is not None
    return sum(
        0.5 * mass * (body["vx"] ** 2 + body["vy"] ** 2)
        for body, mass in zip(batch.traffic.bodies, batch.rows.vehicle["mass"], strict=True)
    )


def test_machines_far_apart_ride_as_alone() -> None:
    """Whoever meets nobody rides the bits of a batch whose rows do not meet, and so does who leads a wake."""
    starts = [(0.0, 0.0, 0.0, 40.0), (200.0, 0.0, 0.0, 40.0), (-15.0, 0.0, 0.0, 40.0)]
    met, alone = placed(starts), placed(starts, together=False)
    for _ in range(50):
        assert not step(met, 0.5)
        step(alone, 0.5)
    for row in (0, 1):
        assert met.state[row].tobytes() == alone.state[row].tobytes()
        assert met.signals[row].tobytes() == alone.signals[row].tobytes()
    assert met.look[2, lk.SPEED] > alone.look[2, lk.SPEED]


def test_wake_is_the_published_one() -> None:
    """Drag behind a motorcycle is that of Blocken et al. (2020) by its size; the momentum is that of its own drag."""
    for behind, drag in ((2.64, 0.52), (10.0, 0.77), (30.0, 0.88), (50.0, 0.93)):
        assert 1.0 - tr.wake_deficit(tr.WAKE_SIZE * behind, 0.0) == pytest.approx(drag)
    assert tr.wake_deficit(0.0, 0.0) == tr.wake_deficit(tr.RANGE, 0.0) == 0.0
    radius = np.linspace(0.0, 3.0, 3001)
    speed = np.sqrt(1.0 - np.array([tr.wake_deficit(tr.WAKE_DISTANCE[0], r) for r in radius]))
    momentum = 2.0 * np.trapezoid(2.0 * np.pi * radius * speed * (1.0 - speed), radius)
    assert momentum == pytest.approx(0.33, rel=0.01)
    offsets = [tr.wake_deficit(10.0, aside) for aside in (0.0, 0.5, 1.0, 2.0)]
    assert offsets == sorted(offsets, reverse=True)
    assert offsets[-1] < 0.01
    # farther back the wake is shallower and wider
    assert tr.wake_deficit(30.0, 1.5) > tr.wake_deficit(3.0, 1.5)


def test_drag_and_downforce_fall_together() -> None:
    """The machine behind feels the part of the drag that its place in the wake leaves."""
    starts = [(0.0, 0.0, 0.0, 70.0), (-13.5, 0.0, 0.0, 70.0)]
    batch = placed(starts)
    step(batch)
    drag = batch.signals[:, SIGNALS.index("drag")]
    front, _ = batch.opponents[1, 0, 1:3]
    gap = front - batch.vehicle.w - 2.0 * tr.RADIUS
    assert drag[1] / drag[0] == pytest.approx(1.0 - tr.wake_deficit(gap, 0.0), rel=2e-3)


def test_sliding_touch_scrapes_and_books_its_energy() -> None:
    """Two that run together side by side are turned apart, ride on, and lose the energy that was booked."""
    batch = placed([(0.0, 0.8, -0.02, 40.0), (0.3, -0.1, 0.02, 40.0)])
    booked, touches, before = 0.0, 0, kinetic(batch)
    for _ in range(40):
        before = kinetic(batch)
        for incident in step(batch):
            if incident["kind"] == tr.CONTACT:
                touches += 1
                booked = incident["energy"]
                assert 0.0 < booked < before
                masses = batch.rows.vehicle["mass"]
                assert incident["approach"] == pytest.approx(1.6, abs=0.4)
                assert booked <= 0.5 * masses[0] / 2.0 * (incident["approach"] ** 2) * 2.0
                assert not incident["thrown"]
                assert not incident["other_thrown"]
    assert touches >= 1
    assert not batch.fallen.any()
    gaps = np.diff(batch.place[:, lk.CENTRE_OFFSET])
    assert abs(gaps[0]) > 2.0 * tr.RADIUS - 0.05


def test_engine_loses_what_a_touch_took() -> None:
    """The speed of the ride after a touch is that of the body that was touched."""
    batch = placed([(0.0, 0.75, -0.04, 40.0), (0.2, -0.05, 0.04, 40.0)])
    for _ in range(40):
        if any(incident["kind"] == tr.CONTACT for incident in step(batch)):
            break
    assert batch.traffic is not None
    wanted = np.hypot(batch.traffic.bodies["vx"], batch.traffic.bodies["vy"])
    step(batch)
    # drag and rolling resistance take 0.05 m/s in a period
    assert batch.look[:, lk.SPEED] == pytest.approx(wanted, abs=0.1)


def test_hit_throws_down_and_the_fallen_lies_in_the_way() -> None:
    """Who rides into another across falls; it slides on, stays where it lies, and is cleared away."""
    batch = placed([(0.0, 0.0, 0.0, 30.0), (0.0, 2.2, -0.45, 30.0)])
    thrown = []
    for _ in range(60):
        thrown += [i for i in step(batch) if i["kind"] == tr.CONTACT and (i["thrown"] or i["other_thrown"])]
        if thrown:
            break
    assert len(thrown) == 1
    step(batch)
    fallen = np.flatnonzero(batch.fallen)
    assert len(fallen) >= 1
    assert batch.fall(int(fallen[0])) == "contact"
    assert batch.wall(int(fallen[0])) is None
    bodies, period = batch.traffic.bodies, CONFIG.control_period  # type: ignore[union-attr]
    speeds: list[float] = []
    while not any(row[0] == tr.CLEARED and row[2] == fallen[0] for row in batch.incidents) and len(speeds) < 2000:
        speeds.append(float(np.hypot(bodies["vx"], bodies["vy"])[fallen[0]]))
        batch.step(np.zeros((2, 2)))
    assert speeds[0] > 10.0
    assert np.diff(speeds[:50]) == pytest.approx(-tr.SLIDING * GRAVITY * period, abs=1e-9)
    assert speeds.count(0.0) * period == pytest.approx(tr.CLEARED_AFTER, abs=0.1)


@pytest.mark.parametrize("speed", [30.0, 60.0, 85.0])
def test_nothing_passes_through_what_lies_there(speed: float) -> None:
    """A machine at any speed meets one that stands in its way, wherever it is at the instants of the steps."""
    for ahead in np.linspace(20.0, 20.0 + speed * CONFIG.control_period, 5):
        batch = placed([(0.0, 0.0, 0.0, speed), (float(ahead), 0.0, 0.0, 5.0)])
        touched = False
        for _ in range(round(60.0 / speed / CONFIG.control_period)):
            touched |= any(incident["kind"] == tr.CONTACT for incident in step(batch))
        assert touched
        assert batch.fallen[0]


def test_passing_is_noted_once_it_is_done() -> None:
    """Who comes by is noted as passing once, and sees the other ahead, then beside, then behind."""
    batch = placed([(0.0, -1.5, 0.0, 50.0), (12.0, 1.5, 0.0, 35.0)])
    seen, passes = [], []
    for _ in range(120):
        passes += [incident for incident in step(batch) if incident["kind"] == tr.PASS]
        seen.append(tuple(np.flatnonzero(batch.opponents[0, :, 0]).tolist()))
    assert [(incident["row"], incident["other"]) for incident in passes] == [(0.0, 1.0)]
    order = list(dict.fromkeys(seen))
    assert order == [(OPPONENT_SLOTS.index(name),) for name in ("ahead_1", "left", "behind")]
    present, x, y, vx, _ = batch.opponents[0, OPPONENT_SLOTS.index("behind")]
    assert present == 1.0
    assert x < 0.0 < y
    assert vx < 0.0


def test_rides_that_meet_go_on_from_a_checkpoint() -> None:
    """A batch that is restored in the middle of a touch rides the same bits."""
    starts = [(0.0, 0.8, -0.02, 40.0), (0.3, -0.1, 0.02, 40.0), (-9.0, 0.0, 0.0, 41.0)]
    batch = placed(starts)
    while not step(batch):
        pass
    stored = batch.state_dict()
    assert stored is not None
    other = Batch(3, CONFIG, together=True)
    other.restore(stored)
    for _ in range(30):
        assert step(batch) == step(other) or not np.isfinite(batch.incidents).all()
    assert batch.state.tobytes() == other.state.tobytes()
    assert batch.opponents.tobytes() == other.opponents.tobytes()


def test_races_of_one_batch_do_not_meet() -> None:
    """Two races on the same places of one batch ride the bits of each alone, and one begins anew without the other."""
    starts = [(0.0, 0.0, 0.0, 40.0), (-12.0, 0.3, 0.0, 43.0)]
    alone, both = placed(starts), Batch(4, CONFIG, together=(0, 1, 0, 1))
    for race in (0, 1):
        for row, (ahead, beside, heading, speed) in zip((race, race + 2), starts, strict=True):
            place = {"progress": STRAIGHT + ahead, "start_offset": beside, "start_heading": heading}
            both.reset(row, ResetRequest(course="barcelona", line=0.0, speed_range=(speed, speed), **place))
        both.meet(race)
        for _ in range(30 * (1 - race)):  # the first race rides on while the second begins
            step(alone, 0.5)
            step(both, 0.5)
    assert both.state[[0, 2]].tobytes() == alone.state.tobytes()
    assert both.opponents[[0, 2]].tobytes() == alone.opponents.tobytes()
    fresh = placed(starts)
    assert both.opponents[[1, 3]].tobytes() == fresh.opponents.tobytes()
    for _ in range(30):
        step(both, 0.5)
        step(fresh, 0.5)
    assert both.state[[1, 3]].tobytes() == fresh.state.tobytes()
    with pytest.raises(ValueError, match="the race of each"):
        Batch(3, CONFIG, together=(0, 1))


def test_rows_that_cannot_meet_are_refused(oval: str) -> None:
    """Rows on different courses, or in a batch that was not made for it, get one clear error."""
    with pytest.raises(ValueError, match="one circuit"):
        placed([(0.0, 0.0, 0.0, 30.0)], together=False).meet()
    batch = placed([(0.0, 0.0, 0.0, 30.0), (20.0, 0.0, 0.0, 30.0)])
    batch.reset(0, ResetRequest(course=oval, line=0.0, speed_range=(20.0, 20.0)))
    with pytest.raises(ValueError, match="one circuit"):
        batch.meet()
