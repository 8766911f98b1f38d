from dataclasses import astuple

import numpy as np
import pytest

from bike_sim.course.random_courses import CURRICULUM_PATHS
from bike_sim.sim.request import Preview
from bike_training.curricula.parts import (
    FAST_AND_SHARP,
    REFINEMENT,
    SLOW_AND_SHARP,
    TRANSITION_STEPS,
    PartsCurriculum,
    PartsSettings,
)

GOOD = [0.05] * 10
BAD = [0.05] * 9 + [0.06]  # eta_e is 0.2 / 3.5 = 0.0571


def test_table_4():
    assert astuple(CURRICULUM_PATHS[0]) == (14, 14, 20, 22, 2, 2)
    assert astuple(CURRICULUM_PATHS[1]) == (12, 14, 18, 22, 2, 4)
    assert astuple(CURRICULUM_PATHS[2]) == (10, 14, 16, 22, 2, 6)
    assert astuple(CURRICULUM_PATHS[3]) == (8, 14, 14, 22, 2, 8)


def test_only_a_fully_successful_validation_passes_a_part():
    curriculum = PartsCurriculum()
    assert not curriculum.validated(1000, BAD)
    assert curriculum.part == 1
    assert curriculum.validated(2000, GOOD)
    assert curriculum.part == 2


def test_ranges_grow_linearly_after_a_part_began():
    curriculum = PartsCurriculum()
    curriculum.validated(5000, GOOD)
    start, half, full = (curriculum.episodes(5000 + n) for n in (0, TRANSITION_STEPS // 2, TRANSITION_STEPS))
    assert start.speed == (4.0, 4.0)
    assert half.speed == pytest.approx((3.0, 5.5))
    assert full.speed == (2.0, 7.0)
    assert start.paths.radius_min == 14
    assert half.paths.radius_min == 13
    assert full.paths == CURRICULUM_PATHS[1]
    assert not curriculum.may_validate(5000 + TRANSITION_STEPS - 1)
    assert curriculum.may_validate(5000 + TRANSITION_STEPS)


def test_the_last_part_finishes_the_curriculum_once():
    curriculum = PartsCurriculum()
    for step in (1, 20_000, 40_000, 60_000):
        assert not curriculum.finished
        assert curriculum.validated(step, GOOD)
    assert curriculum.finished_at == 60_000
    assert not curriculum.validated(80_000, GOOD)
    assert curriculum.finished_at == 60_000
    assert curriculum.episodes(90_000).paths == CURRICULUM_PATHS[3]
    assert curriculum.may_validate(60_001)


def test_refinement_grows_out_of_the_last_part_and_is_not_validated():
    curriculum = PartsCurriculum(PartsSettings(refine=True))
    for step in (1, 20_000, 40_000, 60_000):
        curriculum.validated(step, GOOD)
    start, end = (curriculum.episodes(60_000 + n) for n in (0, TRANSITION_STEPS))
    assert (start.speed, start.paths) == ((2.0, 7.0), CURRICULUM_PATHS[3])
    assert end == REFINEMENT
    validated = curriculum.validation_requests(Preview(), np.random.default_rng(0))[0]
    assert (validated.speed_range, validated.path_ranges) == (start.speed, start.paths)
    assert end.speed[0] < 2.0
    assert end.speed[1] > 7.0


def test_refinement_draws_both_kinds_of_rides_and_never_the_hard_lane_change():
    rng = np.random.default_rng(0)
    requests = [REFINEMENT.draw(rng, Preview()) for _ in range(400)]
    fast = [request for request in requests if request.speed_range == FAST_AND_SHARP.speed]
    assert 150 < len(fast) < 250
    assert all(request.path_ranges.quintic_length_min > 10.0 for request in requests)
    assert len({request.seed for request in requests}) == len(requests)


def test_the_last_part_may_draw_fast_and_slow_sharp_rides():
    """Its validations stay those of the paper."""
    plain, sharp = PartsCurriculum(PartsSettings(refine=True)), PartsCurriculum(PartsSettings(refine=True, sharp=True))
    for step in (1, 20_000, 40_000, 60_000):
        for at in (step - 1, step + TRANSITION_STEPS // 2):
            assert sharp.episodes(at).also == (
                (FAST_AND_SHARP, SLOW_AND_SHARP) if sharp.part >= 4 else plain.episodes(at).also
            )
            assert sharp.episodes(at).paths == plain.episodes(at).paths
            drawn = [each.validation_requests(Preview(), np.random.default_rng(0)) for each in (sharp, plain)]
            assert drawn[0] == drawn[1]
        assert plain.validated(step, GOOD)
        assert sharp.validated(step, GOOD)
    assert sharp.episodes(60_000 + TRANSITION_STEPS) == REFINEMENT


def test_the_last_part_may_be_validated_at_even_speeds():
    """Ten random speeds leave the slowest and the fastest out now and then."""
    curriculum = PartsCurriculum(PartsSettings(last_speeds=21))
    for step in (1, 20_000, 40_000, 60_000):
        requests = curriculum.validation_requests(Preview(), np.random.default_rng(0))
        assert len(requests) == (21 if curriculum.part == 4 else 10)
        curriculum.validated(step, GOOD)
    assert [request.speed_range for request in requests] == [(v, v) for v in np.linspace(2.0, 7.0, 21)]
    assert len({request.seed for request in requests}) == 21


def test_ranges_without_others_draw_no_choice():
    """So that runs without refinement stay the runs that they were."""
    ranges = PartsCurriculum().episodes(0)
    request = ranges.draw(np.random.default_rng(3), Preview())
    assert request.seed == np.random.default_rng(3).integers(2**31)
    assert (request.speed_range, request.path_ranges) == (ranges.speed, ranges.paths)
