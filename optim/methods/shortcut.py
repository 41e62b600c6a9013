"""Shortcut: replace stretches of the path by the exact local planner's cheaper connection.

Source: Esteban Cabezos 2020, section 4.1, algorithms 1 (deterministic, between the planner's nodes) and 2 (random
intervals). The connection may span a cusp and thereby remove it, or may be driven in the other gear where that
costs less. Where a connection continues in the gear of what is beside it, the steering angle is continuous;
where it changes the gear, the steering is free, since the vehicle stands still.

Unlike the source, candidates keep the clearance between samples too, and J may be the cost, not the trailer's length.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from optim.model.clearance import first_violation
from optim.model.flat_map import flat_from_state, not_flat
from optim.model.iterates import IterateStream
from optim.model.objective import objective
from optim.model.path import Path, Samples, Segment, merge, segment_from_states
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from optim.numerics.arrays import Array
from optim.numerics.checks import require
from optim.steering.connect import Connection, Flat, Sampled, connections

_GAIN = 1e-6  # a replacement must save more than this, else rounding is mistaken for progress [m or -]


@dataclass(frozen=True, kw_only=True)
class Shortcut:
    """Replace stretches of the path by cheaper exact connections."""

    variant: Literal["random", "deterministic"] = "random"
    """random: intervals drawn at random (algorithm 2); deterministic: the planner's nodes in order (algorithm 1)."""
    cost: Literal["objective", "trailer_length"] = "objective"
    """What a replacement must lower: J, or the distance travelled by the trailer (the source's choice).

    Over the sample logs J falls to 71 % with the first (geometric mean, random variant), to 78 % with the second,
    which also makes it worse on two of the twelve: a shorter path may steer harder."""
    tries: int = 1000
    """Number of intervals that the random variant draws, M [-]."""
    interval: float = 60.0
    """Longest interval that the random variant draws, L [m]; lengths are uniform up to it."""
    min_curvature: float = 0.0
    """The random variant skips intervals with max |kappa| of the trailer below this [1/m]; 0 skips none."""
    spacing_of_nodes: float = 2.0
    """Distance between candidate nodes [m] for the deterministic variant where the log names none."""
    spacing: float = 0.05
    """Distance between samples of new pieces [m]."""
    seed: int = 0
    """Seed of the random variant [-]."""

    def __post_init__(self) -> None:
        require(
            self,
            "shortcut",
            variant=("random or deterministic", self.variant in ("random", "deterministic")),
            cost=("objective or trailer_length", self.cost in ("objective", "trailer_length")),
            tries=("0 or more", self.tries >= 0),
            interval=("more than 0 m", self.interval > 0.0),
            min_curvature=("0 or more", self.min_curvature >= 0.0),
            spacing_of_nodes=("more than 0 m", self.spacing_of_nodes > 0.0),
            spacing=("more than 0 and at most 0.1 m", 0.0 < self.spacing <= 0.1),
            seed=("0 or more", self.seed >= 0),
        )

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        """Shorten `problem.initial`; ends, limits and `problem.required_clearance` are kept."""
        if sentence := not_flat(problem.vehicle):
            return Result(path=problem.initial, stop=Stop.FAILED, reason=sentence, iterations=0)
        if self.variant == "random":
            return self._solve_random(problem, on_iterate)
        return self._solve_deterministic(problem, on_iterate)

    def _solve_random(self, problem: Problem, on_iterate: OnIterate) -> Result:
        rng = np.random.default_rng(self.seed)
        current = _CurrentPath.of(problem, problem.initial, self.cost)
        iterates = IterateStream.begin(problem, on_iterate)
        accepted = 0
        for trial in range(1, self.tries + 1):
            first, last = _interval(rng, current, self.interval)
            if last <= first or current.kappa[first : last + 1].max() < self.min_curvature:
                continue
            replaced = _replace(problem, self, current, current.before(first), current.after(last))
            if replaced is not None:
                current, piece = replaced
                accepted += 1
                _emit(iterates, problem, current.path, trial, piece.length)
        reason = f"{self.tries} intervals tried, {accepted} replaced"
        return Result(path=current.path, stop=Stop.ITERATION_LIMIT, reason=reason, iterations=self.tries)

    def _solve_deterministic(self, problem: Problem, on_iterate: OnIterate) -> Result:
        current = _CurrentPath.of(problem, problem.initial, self.cost)
        iterates = IterateStream.begin(problem, on_iterate)
        nodes = _nodes(problem, current, self.spacing_of_nodes)
        num_nodes, tries, accepted = len(nodes) + 1, 0, 0
        start = 0.0  # A; `nodes` are those after it
        while nodes:
            # B runs back from the goal to the node after A, the source's order
            for position in range(len(nodes) - 1, -1, -1):
                a, b = current.before(current.index_at(start)), current.after(current.index_at(nodes[position]))
                tries += 1
                replaced = _replace(problem, self, current, a, b)
                if replaced is not None:
                    longer = replaced[1].length - (current.samples.s[b.index] - current.samples.s[a.index])
                    current, piece = replaced
                    nodes = [s + longer for s in nodes[position:]]  # A jumps to B
                    accepted += 1
                    _emit(iterates, problem, current.path, tries, piece.length)
                    break
            start = nodes.pop(0)
        reason = f"{num_nodes} nodes, {tries} connections tried, {accepted} replaced"
        return Result(path=current.path, stop=Stop.CONVERGED, reason=reason, iterations=tries)


def _emit(iterates: IterateStream, problem: Problem, path: Path, number: int, replaced: float) -> None:
    """Announce the path after try `number`, which replaced a piece by one of length `replaced` [m]."""
    value = objective(path, problem.weights)
    iterates.emit(lambda n: Iterate(iteration=n, path=path, objective=value, step=replaced), number)


@dataclass(frozen=True, eq=False)
class _IntervalEnd:
    """One end of an interval: a sample, and how the path beside the interval drives there."""

    index: int
    state: Array
    flat: Array
    gear: int  # of the path outside the interval; 0 at the ends of the path
    phi: float


@dataclass(frozen=True, eq=False)
class _CurrentPath:
    """The current path with what the tries look up: running cost, flat states."""

    path: Path
    samples: Samples
    flat: Array  # (N, 5)
    kappa: Array  # (N,) absolute
    cost: Array  # (N,) running cost up to each sample
    changes: Array  # (N,) gear changes up to each sample

    @staticmethod
    def of(problem: Problem, path: Path, cost: str) -> "_CurrentPath":
        samples = path.samples
        flat = flat_from_state(problem.vehicle, samples.states, samples.phi)
        changes = np.concatenate([[0], np.cumsum(np.diff(samples.segment))])
        running = _running_cost(problem, samples, cost)
        return _CurrentPath(path, samples, flat, np.abs(flat[:, 3]), running, changes)

    def index_at(self, s: float) -> int:
        """The sample nearest to an arc length."""
        right = min(int(np.searchsorted(self.samples.s, s)), len(self.samples.s) - 1)
        left = max(right - 1, 0)
        return left if s - self.samples.s[left] < self.samples.s[right] - s else right

    def before(self, index: int) -> _IntervalEnd:
        """The start of an interval: at a cusp, the last sample of the segment that ends there."""
        if index > 0 and self.samples.segment[index] != self.samples.segment[index - 1]:
            index -= 1
        return self._end(index, outer=index > 0)

    def after(self, index: int) -> _IntervalEnd:
        """The end of an interval: at a cusp, the first sample of the segment that begins there."""
        last = len(self.samples.s) - 1
        if index < last and self.samples.segment[index] != self.samples.segment[index + 1]:
            index += 1
        return self._end(index, outer=index < last)

    def _end(self, index: int, outer: bool) -> _IntervalEnd:
        gear = int(self.samples.direction[index]) if outer else 0
        return _IntervalEnd(index, self.samples.states[index], self.flat[index], gear, float(self.samples.phi[index]))

    def gears(self, start: _IntervalEnd, end: _IntervalEnd) -> tuple[int, ...]:
        """The gears worth trying: both where the interval has a cusp, else the one that it is driven in."""
        has_cusp = self.changes[end.index] > self.changes[start.index]
        return (1, -1) if has_cusp else (int(self.samples.direction[end.index]),)


def _running_cost(problem: Problem, samples: Samples, cost: str) -> Array:
    """Cost of the path up to each sample: J's terms, or the trailer's distance. Shape (N,)."""
    steps = _steps(problem, cost, samples.s, samples.states, samples.phi)
    if cost == "objective":
        is_cusp = np.diff(samples.segment) != 0
        steps += is_cusp * (problem.weights.cusp + problem.weights.jump * np.diff(samples.phi) ** 2)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _steps(problem: Problem, cost: str, s: Array, states: Array, phi: Array) -> Array:
    """Cost from each sample to the next, gear changes left out. Shape (N - 1,)."""
    ds = np.diff(s)
    if cost == "trailer_length":
        cos = np.cos(states[:, 3])
        return ds * (cos[1:] + cos[:-1]) / 2.0
    weights, left, change = problem.weights, phi[:-1], np.diff(phi)
    square = left * (left + change) + change * change / 3.0
    rate = np.divide(change * change, ds, out=np.zeros_like(ds), where=ds > 0.0)
    return ds * (weights.length + weights.steer * square) + weights.rate * rate


def _interval(rng: np.random.Generator, current: _CurrentPath, longest: float) -> tuple[int, int]:
    """Two samples whose distance along the path is uniform up to `longest`."""
    total = current.path.length
    length = rng.uniform(0.0, min(longest, total))
    start = rng.uniform(-0.1 * total, 1.1 * total - length)  # beyond the ends: the path's own ends get their share
    return current.index_at(max(start, 0.0)), current.index_at(min(start + length, total))


def _nodes(problem: Problem, current: _CurrentPath, spacing: float) -> list[float]:
    """Arc lengths of the parent nodes after the first: the log's where the current path is the recorded one.

    Without such nodes, segment ends and equal spacing.
    """
    total = current.path.length
    if problem.nodes is not None and problem.start is None:
        nodes = np.append(problem.nodes, total)
    else:
        ends = np.cumsum([segment.length for segment in current.path.segments])
        nodes = np.concatenate([np.linspace(0.0, total, max(2, math.ceil(total / spacing) + 1)), ends])
    nodes = np.unique(np.round(nodes, 6))
    return [float(s) for s in nodes if s > 0.5 * problem.initial.segments[0].s[1]]


def _replace(
    problem: Problem, options: Shortcut, current: _CurrentPath, start: _IntervalEnd, end: _IntervalEnd
) -> tuple[_CurrentPath, Segment] | None:
    """The path with the interval replaced by its cheapest connection, and that; None where nothing is saved."""
    if end.index <= start.index:
        return None
    old = current.cost[end.index] - current.cost[start.index]
    piece = _steer(problem, options, start, end, current.gears(start, end), old)
    if piece is None:
        return None
    return _CurrentPath.of(problem, _spliced(current, start, end, piece), options.cost), piece


def _steer(
    problem: Problem, options: Shortcut, start: _IntervalEnd, end: _IntervalEnd, gears: tuple[int, ...], old: float
) -> Segment | None:
    """The cheapest connection that saves something over `old` and keeps clear, or None."""
    chord = math.hypot(end.flat[0] - start.flat[0], end.flat[1] - start.flat[1])
    found: list[tuple[float, int, Sampled]] = []
    for gear in gears:
        extra = _cusp_cost(problem, options, start, end, gear)
        budget = _longest(problem, options, old - extra - _GAIN)
        if chord >= budget:
            continue
        for connection in _connections(problem, start, end, gear, budget):
            if extra + _estimate(problem, options, connection) >= old:
                continue
            piece = _snapped(connection.sample(options.spacing), start, end)
            cost = extra + _cost(problem, options, piece) + _jump_cost(problem, options, start, end, gear, piece)
            if cost < old - _GAIN:
                found.append((cost, gear, piece))
    for _, gear, piece in sorted(found, key=lambda item: item[0]):
        clear = problem.required_clearance
        if first_violation(problem.scene, problem.vehicle, piece.s, piece.states, clear, phi=piece.phi) < 0:
            return segment_from_states(gear, *piece)
    return None


def _connections(
    problem: Problem, start: _IntervalEnd, end: _IntervalEnd, gear: int, budget: float
) -> list[Connection]:
    """Connections in one gear, with the steering continuous where the gear beside is the same."""
    a, b = start.flat.copy(), end.flat.copy()
    if start.gear != gear:
        a[4] = 0.0
    if end.gear != gear:
        b[4] = 0.0
    return connections(problem.vehicle, Flat(*a), Flat(*b), gear, max_length=budget)


def _longest(problem: Problem, options: Shortcut, budget: float) -> float:
    """The longest distance of the trailer that costs no more than the budget, whatever the steering [m]."""
    if options.cost == "trailer_length":
        return budget
    # J >= w_length * distance of the truck >= w_length * distance of the trailer
    return budget / problem.weights.length if problem.weights.length > 0 else math.inf


def _snapped(piece: Sampled, start: _IntervalEnd, end: _IntervalEnd) -> Sampled:
    """The piece with its end states set to the path's, which it meets up to rounding.

    Cusps share a pose exactly; the flat map and back loses the last digit.
    """
    states = piece.states.copy()
    turns = round((states[-1, 2] - end.state[2]) / (2.0 * math.pi))
    states[0], states[-1] = start.state, end.state + np.array([0.0, 0.0, 2.0 * math.pi * turns, 0.0])
    return piece._replace(states=states)


def _cusp_cost(problem: Problem, options: Shortcut, start: _IntervalEnd, end: _IntervalEnd, gear: int) -> float:
    """Cost of the gear changes that a connection in this gear makes at its ends."""
    if options.cost == "trailer_length":
        return 0.0
    return problem.weights.cusp * sum(outside.gear == -gear for outside in (start, end))


def _estimate(problem: Problem, options: Shortcut, connection: Connection) -> float:
    """Cost of a connection from few samples: one that costs too much here is rejected.

    Not a proven bound, but of 4762 connections on the sample logs none cost less than its estimate.
    """
    if options.cost == "trailer_length":
        return connection.trailer_length
    steer, rate = connection.effort
    weights = problem.weights
    return weights.length * connection.truck_length + weights.steer * steer + weights.rate * rate


def _cost(problem: Problem, options: Shortcut, piece: Sampled) -> float:
    """Cost of a connection by itself."""
    return float(_steps(problem, options.cost, *piece).sum())


def _jump_cost(
    problem: Problem, options: Shortcut, start: _IntervalEnd, end: _IntervalEnd, gear: int, piece: Sampled
) -> float:
    """Cost of the steering at standstill where a connection changes the gear."""
    if options.cost == "trailer_length":
        return 0.0
    ends = ((start, piece.phi[0]), (end, piece.phi[-1]))
    return problem.weights.jump * sum((outside.phi - phi) ** 2 for outside, phi in ends if outside.gear == -gear)


def _spliced(current: _CurrentPath, start: _IntervalEnd, end: _IntervalEnd, piece: Segment) -> Path:
    """The path with the interval replaced; headings behind it follow the piece's, which may differ by full turns."""
    samples = current.samples
    turn = 2.0 * math.pi * round((piece.theta[-1] - end.state[2]) / (2.0 * math.pi))
    segments: list[Segment] = []
    for k, segment in enumerate(current.path.segments):
        inside = np.flatnonzero(samples.segment == k)
        low, high = int(inside[0]), int(inside[-1])
        if low < start.index:
            segments.append(_part(segment, 0, min(high, start.index) - low))
        if low <= start.index <= high:
            segments.append(piece)
        if high > end.index:
            segments.append(_part(segment, max(low, end.index) - low, high - low, turn))
    return merge(segments)


def _part(segment: Segment, first: int, last: int, turn: float = 0.0) -> Segment:
    part = slice(first, last + 1)
    states = segment.states[part] + np.array([0.0, 0.0, turn, 0.0])
    return segment_from_states(segment.direction, segment.s[part], states, segment.phi[part])
