"""Tables of the superbike paper's experiments."""

from __future__ import annotations

from dataclasses import dataclass

from bike_training.reproduce.data import Tables, table


@dataclass(frozen=True)
class Laps:
    """Rides of an actor on the circuit and the machine that it learned on (Tables I and II).

    Attributes:
        setting, seed: of its run. actor: ``early``, ``late`` or ``best``. step: learning step that it is of.
        rides: number of starts. whole: rides that finished all laps with never both contact points outside the limits.
        falls, walls: rides that ended with a fall, or at a wall.
        laps: flying laps finished. mean, best: of the flying laps of whole rides, s; -1 where there is none.
        line: mean distance to the ideal line, m. outside: time with both contact points outside the limits, s a ride.
    """

    setting: str
    seed: int
    actor: str
    step: int
    rides: int
    whole: int
    falls: int
    walls: int
    laps: int
    mean: float
    best: float
    line: float
    outside: float


@dataclass(frozen=True)
class Transfer:
    """Rides of a run's best actor on a machine, without learning on it (Table III).

    Attributes:
        setting, seed: of its run. circuit: its name. machine: its name. rides: number of starts, a flying lap each.
        whole: as of `Laps`. best, median: of the flying laps of whole rides, s; -1 where there is none.
    """

    setting: str
    seed: int
    circuit: str
    machine: str
    rides: int
    whole: int
    best: float
    median: float


@dataclass(frozen=True)
class Context:
    """The distribution of the context after an update (V).

    Attributes:
        setting, seed: of the run. iteration: number of the update. step: learning step. stage: what it did.
        d_median, d_ideal: means, as parts of the distance between both lines. v_max: mean, m/s.
        std_d_median, std_d_ideal, std_v_max: standard deviations, in the same units.
        correlation: of d_median and v_max. kl: divergence from the target, nat. value: expected return.
    """

    setting: str
    seed: int
    iteration: int
    step: int
    stage: str
    d_median: float
    d_ideal: float
    v_max: float
    std_d_median: float
    std_d_ideal: float
    std_v_max: float
    correlation: float
    kl: float
    value: float


@dataclass(frozen=True)
class Episodes:
    """The last 100 episodes of learning at a step.

    Attributes:
        setting, seed: of the run. step: learning step. length: mean, decisions. total: mean return.
    """

    setting: str
    seed: int
    step: int
    length: float
    total: float


@dataclass(frozen=True)
class Moment:
    """An instant of a flying lap, for Figs. 3 and 4.

    Attributes:
        setting, seed: of the run. time: s. progress: along the centre line, m, of any lap. x, y: rear contact, m.
        speed: m/s.
        error: distance to the ideal line, m, positive to the left.
    """

    setting: str
    seed: int
    time: float
    progress: float
    x: float
    y: float
    speed: float
    error: float


@dataclass(frozen=True)
class Data(Tables):
    """All tables; the error of a validation is its rides' mean excess over the planned lap, 1 of one not whole."""

    laps: tuple[Laps, ...] = table("laps.csv", Laps)
    transfers: tuple[Transfer, ...] = table("transfer.csv", Transfer)
    contexts: tuple[Context, ...] = table("context.csv", Context)
    episodes: tuple[Episodes, ...] = table("episodes.csv", Episodes)
    moments: tuple[Moment, ...] = table("moments.csv", Moment)
