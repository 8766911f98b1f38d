"""Racing by rule in constructed situations: a straight that ends in a corner, and others placed around a machine."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bike_policy.planning import racecraft as rc
from bike_policy.planning.lap_plan import P_CURVATURE, P_FASTER, P_LEFT, P_LONGITUDINAL, P_RIGHT, P_SPEED, PLAN
from bike_policy.planning.line_law import LATERAL_ERROR, PROGRESS, SEEN, SPEED, slower_inside
from bike_sim.schema import OPPONENT, OPPONENT_SLOTS

PERIOD, RATE = 0.02, 1.6
SPACING = 5.0
STRAIGHT, CORNER = 1500.0, 200.0
FAST, SLOW = 60.0, 22.0
BRAKES = 9.0
BRAKING_AT = STRAIGHT - (FAST**2 - SLOW**2) / (2.0 * BRAKES)
ROOM = 4.0
Plans = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def plan_of(turn: float = 1.0) -> Plans:
    """Return the plan of a straight at 60 m/s, its braking, and a corner to the left (1) or right (-1)."""
    s = np.arange(0.0, STRAIGHT + CORNER + SPACING, SPACING)
    table = np.zeros((len(s), len(PLAN)))
    braking = (s > BRAKING_AT) & (s < STRAIGHT)
    table[:, P_SPEED] = np.where(s < STRAIGHT, FAST, SLOW)
    table[braking, P_SPEED] = np.sqrt(FAST**2 - 2.0 * BRAKES * (s[braking] - BRAKING_AT))
    table[braking, P_LONGITUDINAL] = -BRAKES
    table[:, P_CURVATURE] = np.where(s < STRAIGHT, 0.0, turn / 45.0)
    table[:, [P_LEFT, P_RIGHT]], table[:, P_FASTER] = ROOM, 0.03
    return table, np.zeros(1, dtype=np.int64), np.array([len(s) - 2]), np.array([SPACING])


class Rider:
    """One machine on the straight; its line is the x axis."""

    def __init__(self, s: float, speed: float = FAST, turn: float = 1.0, side: float = 0.0) -> None:
        self.plans, self.memory = plan_of(turn), np.zeros((1, len(rc.CRAFT)))
        self.memory[0, 1] = side
        self.s, self.speed, self.aside, self.asked = s, speed, 0.0, np.zeros(1)

    def targets(
        self, wanted: tuple[float, float] | None = None, **others: tuple[float, float, float]
    ) -> tuple[float, float]:
        """Return offset and pace; others by slot as distance ahead and to the left (m) and speed (m/s).

        Where somebody else wants targets, these are what is left of them.
        """
        observed, seen = np.zeros((1, SEEN)), np.zeros((1, len(OPPONENT_SLOTS), len(OPPONENT)))
        observed[0, [SPEED, PROGRESS, LATERAL_ERROR]] = self.speed, self.s, self.aside
        for slot, (ahead, left, speed) in others.items():
            seen[0, OPPONENT_SLOTS.index(slot)] = 1.0, ahead, left - self.aside, speed - self.speed, 0.0
        points = np.zeros((1, 20, 3))
        points[0, :, 0], points[0, :, 1] = 10.0 * np.arange(20), -self.aside
        out = np.zeros((1, 2))
        if wanted is not None:
            out[0] = wanted
            rc.guard_targets(observed, points, seen, self.plans, RATE, PERIOD, self.asked, out)
        else:
            rc.race_targets(observed, points, seen, self.memory, self.plans, PERIOD, out)
        return float(out[0, 0]), float(out[0, 1])

    @property
    def side(self) -> float:
        """Side on which it passes."""
        return float(self.memory[0, 1])


PLANNED = plan_of()[0][:, P_SPEED]


def planned(s: float) -> float:
    """Return the planned speed at a place."""
    return float(np.interp(s, SPACING * np.arange(len(PLANNED)), PLANNED))


def follow(
    rider: Rider, behind: float, slower: float, wanted: tuple[float, float] | None = None
) -> tuple[list[float], float]:
    """Ride up to the corner behind a machine that rides a part of the plan; return gaps, m, and hardest braking."""
    leader, pace, gaps, braking = rider.s + behind, 0.0, [], 0.0
    while leader < STRAIGHT + 100.0:
        _, asked = rider.targets(wanted, ahead_1=(leader - rider.s, 0.0, slower * planned(leader)))
        pace += PERIOD / 0.3 * (asked - pace)
        before, rider.speed = rider.speed, (1.0 + pace) * planned(rider.s)
        braking = max(braking, (before - rider.speed) / PERIOD)
        rider.s, leader = rider.s + PERIOD * rider.speed, leader + PERIOD * slower * planned(leader)
        gaps.append(leader - rider.s - rc.MACHINE)
    return gaps, braking


@pytest.mark.parametrize(("slower", "behind"), [(1.0, 25.0), (0.9, 40.0)])
def test_headway_lets_a_machine_brake_with_the_one_ahead(slower: float, behind: float) -> None:
    """Behind one that rides the plan or a tenth slower, up to the corner: never nearer than half a machine's length,
    and no harder on the brake than the plan is."""
    rider = Rider(400.0)
    rider.plans[0][:, [P_LEFT, P_RIGHT]] = 1.0  # no room to pass
    gaps, braking = follow(rider, behind, slower)
    assert min(gaps) > 0.5 * rc.MACHINE
    assert braking < 1.2 * BRAKES
    assert gaps[-1] < 30.0  # it does follow


@pytest.mark.parametrize(
    ("to_corner", "theirs", "passes"), [(900.0, 50.0, True), (150.0, 50.0, False), (900.0, 59.8, False)]
)
def test_a_pass_begins_where_it_ends_before_the_turn_in(to_corner: float, theirs: float, passes: bool) -> None:
    """It takes a difference of speed and a straight that is long enough."""
    rider = Rider(STRAIGHT - to_corner)
    rider.targets(ahead_1=(18.0, 0.0, theirs))
    assert (rider.side != 0.0) == passes


def test_no_pass_where_is_no_room_or_somebody_else() -> None:
    """Not off the circuit, and not into who is beside or comes from behind."""
    blocked = {"left": (0.0, 2.5, FAST), "right": (0.0, -2.5, FAST)}
    for others in (blocked, blocked | {"behind": (-3.0, -2.0, FAST + 5.0)}):
        rider = Rider(STRAIGHT - 900.0)
        rider.targets(ahead_1=(15.0, 0.0, 40.0), **others)
        assert rider.side == 0.0
    rider = Rider(STRAIGHT - 900.0)
    rider.plans[0][:, [P_LEFT, P_RIGHT]] = 1.0
    rider.targets(ahead_1=(15.0, 0.0, 40.0))
    assert rider.side == 0.0


@pytest.mark.parametrize("ahead", [-1.5, 0.0, 1.5])
@pytest.mark.parametrize("to_corner", [900.0, 20.0, -100.0])
def test_beside_another_nobody_comes_nearer(ahead: float, to_corner: float) -> None:
    """Whoever is ahead leaves room, on the straight and in the corner, also where the line lies beyond the other."""
    rider = Rider(STRAIGHT - to_corner, speed=planned(STRAIGHT - to_corner))
    rider.aside = rider.memory[0, 0] = 2.5
    for _ in range(200):
        offset, _ = rider.targets(right=(ahead, 0.5, rider.speed))
        assert offset >= 0.5 + rc.CLEARANCE
    free = Rider(rider.s, speed=rider.speed)
    free.memory[0, 0] = 2.5
    assert [free.targets() for _ in range(500)][-1][0] == pytest.approx(0.0, abs=0.05)


def test_a_pass_that_cannot_be_ended_is_given_up_in_time() -> None:
    """With the corner too near, who is behind by a part of a machine drops back beside; who is ahead goes on."""
    for ahead, gives_up in ((1.5, True), (-0.5, False)):
        rider = Rider(BRAKING_AT + 60.0, speed=planned(BRAKING_AT + 60.0), side=1.0)
        rider.aside = rider.memory[0, 0] = 2.0
        theirs = planned(rider.s + ahead)
        offset, pace = rider.targets(right=(ahead, 0.0, theirs))
        assert (rider.side == 0.0) == gives_up
        assert ((1.0 + pace) * planned(rider.s) < theirs - 1.0) == gives_up
        assert offset >= rc.CLEARANCE


def test_what_stands_in_the_way_is_passed_or_braked_for() -> None:
    """In a corner as well; beside the way it does not matter."""
    rider = Rider(STRAIGHT + 20.0, speed=SLOW)
    assert rider.targets(ahead_1=(20.0, 4.0, 0.0)) == (0.0, 0.0)
    rider = Rider(STRAIGHT + 20.0, speed=SLOW)
    _, pace = rider.targets(ahead_1=(40.0, 0.0, 0.0))
    assert rider.side != 0.0
    rider.plans[0][:, [P_LEFT, P_RIGHT]] = 1.0
    _, pace = rider.targets(ahead_1=(20.0, 0.0, 0.0))
    assert rider.side == 0.0
    assert (1.0 + pace) * SLOW <= math.sqrt(2.0 * rc.BRAKING * 20.0)


def test_the_mirrored_situation_gives_the_mirrored_answer() -> None:
    """Left and right are alike."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        s, aside, side = rng.uniform(0.0, STRAIGHT + CORNER), rng.uniform(-3.0, 3.0), float(rng.integers(-1, 2))
        ways = {"ahead_1": (3.0, 40.0), "ahead_2": (40.0, 60.0), "left": (-2.0, 2.0), "behind": (-20.0, -3.0)}
        seen = {
            slot: (rng.uniform(*way), aside + rng.uniform(0.7, 3.0) * (1.0 if slot == "left" else rng.choice([-1, 1])),
                   rng.uniform(0.8, 1.05) * planned(s))
            for slot, way in ways.items() if rng.random() < 0.6
        }  # fmt: skip
        answers = []
        for sign in (1.0, -1.0):
            rider = Rider(s, planned(s), sign, sign * side)
            rider.aside = rider.memory[0, 0] = sign * aside
            slots = {"left": "right"} if sign < 0.0 else {}
            offset, pace = rider.targets(
                **{slots.get(slot, slot): (x, sign * y, speed) for slot, (x, y, speed) in seen.items()}
            )
            answers.append((sign * offset, pace, sign * rider.side))
        assert answers[0] == pytest.approx(answers[1], abs=1e-12)


def test_targets_of_a_policy_leave_room_to_others() -> None:
    """Nobody rides into who is straight ahead or beside; past others, and alone, targets stay what they are."""
    rider, wanted = Rider(400.0), (1.0, 0.08)
    rider.asked[0] = rider.aside = 1.0
    assert rider.targets(wanted) == wanted
    assert rider.targets(wanted, behind=(-3.0, 1.0, FAST)) == wanted
    assert rider.targets(wanted, ahead_1=(10.0, -1.0, 0.9 * FAST)) == wanted  # past it on the left
    offset, pace = rider.targets(wanted, ahead_1=(6.0, 1.3, 0.9 * FAST))
    assert offset == 1.0
    assert pace < -0.09
    rider.aside = 0.0
    for _ in range(round(5.0 * rc.ESCAPE_TIME / PERIOD)):
        asked = rider.asked[0]
        offset, pace = rider.targets(wanted, left=(0.5, 1.9, FAST))
        assert 0.0 <= asked - offset <= rc.ESCAPE_RATE * PERIOD
        assert pace == 0.08
    assert offset == pytest.approx(1.9 - rc.CLEARANCE, abs=0.02)


def test_a_policy_that_is_astray_before_a_corner_is_slowed() -> None:
    """As the classical rider is: it would have to turn harder than planned to come back."""
    rider = Rider(STRAIGHT - 30.0, planned(STRAIGHT - 30.0))
    rider.asked[0], rider.aside = 1.0, 1.4
    assert rider.targets((1.0, 0.02)) == (1.0, 0.02)
    rider.aside = -1.5
    assert rider.targets((1.0, 0.02)) == (1.0, pytest.approx(0.02 - 2.0 * rc.ASTRAY))
    assert rider.targets((1.0, 0.08)) == (1.0, pytest.approx(0.03 - 2.0 * rc.ASTRAY))  # of what is granted
    far = Rider(400.0)
    far.asked[0], far.aside = 1.0, -1.5
    assert far.targets((1.0, 0.02)) == (1.0, 0.02)


@pytest.mark.parametrize(("aside", "slower"), [(8.0, True), (-8.0, True), (1.9, False)])
def test_a_policy_far_from_its_line_brakes_a_little_earlier(aside: float, slower: bool) -> None:
    """Shortly before the plan does and no sooner: it crosses the road while it brakes."""
    for s, soon in ((BRAKING_AT - 30.0, True), (BRAKING_AT - 90.0, False)):
        rider = Rider(s)
        rider.asked[0] = rider.aside = aside
        assert (rider.targets((aside, 0.03))[1] < 0.0) == (slower and soon)


@pytest.mark.parametrize("offset", [1.0, 1e-9, 0.0, -1.0])
def test_a_policy_inside_its_corner_loses_the_pace_that_it_costs(offset: float) -> None:
    """It turns in 45 m less the distance; next to nothing where that is next to nothing."""
    observed, targets = np.zeros((1, SEEN)), np.array([[offset, 0.08]])
    observed[0, [SPEED, PROGRESS]] = SLOW, STRAIGHT + 20.0
    slower_inside(observed, targets, 0.03, plan_of())
    assert targets[0, 1] == (pytest.approx(0.03 - 0.5 * offset / 45.0) if offset > 0.0 else 0.08)


@pytest.mark.parametrize("slower", [1.0, 0.95])
def test_a_policy_that_asks_for_the_most_does_not_need_to_brake_harder_than_planned(slower: float) -> None:
    """It has closed up when the corner comes, and not before: on the brake there is little left."""
    gaps, braking = follow(Rider(400.0), 25.0, slower, (0.0, 0.03))
    assert min(gaps) > 0.5 * rc.MACHINE
    assert gaps[-1] < 6.0
    assert braking < 1.1 * BRAKES


def test_machines_side_by_side_get_what_each_gets_alone() -> None:
    """Of two that follow others, in either order."""
    table, first, last, spacing = plan_of()
    plans = table, np.repeat(first, 2), np.repeat(last, 2), np.repeat(spacing, 2)
    observed, seen = np.zeros((2, SEEN)), np.zeros((2, len(OPPONENT_SLOTS), len(OPPONENT)))
    observed[:, [SPEED, PROGRESS]] = (FAST, BRAKING_AT - 30.0), (FAST, 400.0)
    seen[:, OPPONENT_SLOTS.index("ahead_1")] = (1.0, 12.0, 0.0, -3.0, 0.0), (1.0, 9.0, 0.5, -2.0, 0.4)
    points = np.zeros((2, 20, 3))
    points[:, :, 0] = 10.0 * np.arange(20)
    found = []
    for order in ([0, 1], [1, 0], [0], [1]):
        asked, targets = np.zeros(len(order)), np.tile([2.0, 0.03], (len(order), 1))
        rc.guard_targets(observed[order], points[order], seen[order], plans, RATE, PERIOD, asked, targets)
        found.append(targets)
    np.testing.assert_array_equal(found[0], found[1][::-1])
    np.testing.assert_array_equal(found[0], np.concatenate(found[2:]))


def test_before_the_brakes_a_policy_follows_also_who_may_come_over() -> None:
    """And in corners; on an open straight it rides past at less."""
    cases = (400.0, 1.3, False), (BRAKING_AT - 30.0, 1.3, True), (BRAKING_AT - 30.0, 1.5, False), (1520.0, 1.3, True)
    for s, apart, follows in cases:
        _, pace = Rider(s, planned(s)).targets((0.0, 0.03), ahead_1=(6.0, apart, 0.9 * planned(s + 6.0)))
        assert (pace < -0.02) == follows


@pytest.mark.parametrize(("s", "rate"), [(400.0, RATE), (STRAIGHT + 20.0, rc.CORNER_RATE)])
def test_targets_move_at_their_rate_and_slowly_in_corners(s: float, rate: float) -> None:
    """On the straight at most at the rate that is given, from before a corner on at that of a choice there."""
    rider = Rider(s, planned(s))
    assert rider.targets((3.0, 0.0))[0] == pytest.approx(rate * PERIOD)
    for _ in range(round(5.0 * rc.SETTLING / PERIOD)):
        before = rider.asked[0]
        assert abs(rider.targets((0.4, 0.0))[0] - 0.4) <= abs(before - 0.4)
    assert rider.asked[0] == pytest.approx(0.4, abs=0.01)
