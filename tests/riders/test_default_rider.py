"""The rider of a vehicle where none is chosen: in the node, in the commands, and for one vehicle after the other."""

from dataclasses import replace

import pytest

from bike_policy.contract.bundle import DEFAULT_POLICY, DEFAULT_RACER
from bike_policy.riders import rider as riders
from bike_policy.riders.base import bundle_of
from bike_policy.riders.rider import DEFAULT, default_name, make_rider
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator
from bike_sim.vehicles.files import load_vehicle
from bike_training import cli
from bike_training.rollout.rollout import ride_through

BICYCLE = load_vehicle("whipple")


@pytest.mark.parametrize("vehicle", ["whipple", "r1"])
@pytest.mark.parametrize("command", ["ride", "live"])
def test_commands_choose_as_the_node_does(command: str, vehicle: str) -> None:
    expected = {"whipple": DEFAULT_POLICY, "r1": DEFAULT_RACER}[vehicle]
    assert default_name(load_vehicle(vehicle)) == expected
    for words in ([], ["--rider", DEFAULT]):
        assert cli.parse(command, ["--vehicle", vehicle, *words]).rider == expected


def test_a_bicycle_that_no_policy_was_trained_for_has_a_rider_designed_for_it() -> None:
    assert default_name(replace(BICYCLE, name="cargo")) == "lqr"


def test_it_rides_as_the_chosen_rider_does() -> None:
    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=0.01))
    request = ResetRequest(seed=2, course="circle", speed_range=(4.0, 4.0), perturb=True)
    rides = [ride_through(simulator, make_rider(name), request, 2.0).figures() for name in (DEFAULT, DEFAULT_POLICY)]
    assert rides[0] == rides[1]


def test_it_chooses_again_for_another_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[tuple[str, str]] = []

    class Named:
        preview = None

        def __init__(self, name: str) -> None:
            self.name = name

        def begin(self, vehicle, *_) -> None:
            begun.append((self.name, vehicle.name))

    rider = make_rider(DEFAULT)
    monkeypatch.setattr(riders, "make_rider", Named)
    for name in ("whipple", "r1", "r1", "whipple"):
        rider.begin(load_vehicle(name), None, 0.05, None)
        assert rider.name == begun[-1][0]
    bicycle, superbike = (DEFAULT_POLICY, "whipple"), (DEFAULT_RACER, "r1")
    assert begun == [bicycle, superbike, superbike, bicycle]
    assert bundle_of(make_rider(DEFAULT)) is None
