"""A planner that sees the simulator state: best-first search over action sequences, simulated in a world.

It searches for the sequence with the best A-Success. If goals i with rewards r_i (sum 1) are touched at actions k_i,
A-Success is 1 − Σ r_i ln k_i / ln(N + 1), so the cost is Σ r_i ln k_i. The lower bound of the cost follows from the
distance that the agent can move per action, without cubes in its way. An action is simulated only when its bound is the
smallest of all: this is A*. The first solution is the best one, with two exceptions: the bound ignores goals that are
pushed towards the agent, and similar states count as equal.
"""

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence

import msgspec
import numpy as np

from gym_open.envs import constants as c
from gym_open.envs.physics.model import kind_of
from gym_open.envs.puzzles import SIDES, Pen, Puzzle, PuzzleError
from gym_open.envs.tasks import REWARDS, judge, step_budget
from gym_open.envs.world import World

REACH = c.MOVE_SPEED * c.CONTROL_DT_S
"""Metres on each axis that the agent moves per action on a free table."""
TOUCH = 2 * c.RADIUS
"""Distance between the centres of two spheres in contact."""
AGENT_GRAIN, OBJECT_GRAIN = REACH / 16, REACH / 8
"""Grid sizes for the agent and for other objects: states with equal grid positions count as equal."""
SIMULATIONS = 3000
"""Steps simulated in a search before the next search, which is greedier."""
GREED = (1.0, 2.0, 5.0)
"""Factor per search on the estimate of the remaining moves; with 1, the first solution found is the best."""
SHIFTS_M = (1e-9,) * 2 + (1e-6,) * 2 + (1e-4,) * 4
"""Standard deviations in metres of random shifts of all objects, after which a robust sequence still solves it."""


class Solution(msgspec.Struct, frozen=True):
    """A solution of a puzzle."""

    actions: tuple[int, ...]
    """A sequence that earns the whole return."""
    robust: bool
    """Whether it also does so after each shift of `SHIFTS_M`."""
    simulated: int
    """Number of steps simulated to find it."""


class _Node(msgspec.Struct):
    state: np.ndarray
    agent: np.ndarray
    goals: dict[str, np.ndarray]
    """Positions of the goals not yet touched."""
    cost: float
    actions: tuple[int, ...]


def plan(puzzle: Puzzle, world: World | None = None) -> Solution:
    """Find a sequence of actions that earns the puzzle's whole return, with the best A-Success found.

    Args:
        puzzle: a puzzle of a task.
        world: a world for simulation; its puzzle and state are lost.

    Raises:
        PuzzleError: if the searches end without a solution.
    """
    world = world or World()
    spare: Solution | None = None
    total = 0
    for greed in GREED:
        for actions, simulated in _search(world, puzzle, greed):
            found = Solution(actions, robust=is_robust(world, puzzle, actions), simulated=total + simulated)
            if found.robust:
                return found
            spare = spare or found
        if spare:
            return spare
        total += SIMULATIONS
    raise PuzzleError(f"no solution of {puzzle.to_json().decode()} found in {total} simulated steps")


def solves(world: World, puzzle: Puzzle, actions: Sequence[int], shift: np.ndarray | None = None) -> bool:
    """Whether the actions earn the whole return, and the last one terminates the episode.

    Args:
        world: a world for simulation.
        puzzle: the puzzle to solve.
        actions: the actions from the start.
        shift: (N, 3) metres by which all objects are moved first.
    """
    world.load(puzzle)
    if shift is not None:
        state = world.save_state()
        state[1 : 1 + world.model.nq].reshape(-1, 7)[:, :3] += shift  # the first number is the time
        world.restore_state(state)
    earned, hits, terminated = 0.0, 0, False
    for action in actions:
        if terminated:
            return False
        outcome = world.step(action)
        verdict = judge(puzzle.task, puzzle, hits, outcome)
        earned, hits, terminated = earned + verdict.reward, hits + len(outcome.hits), verdict.terminated
    return terminated and math.isclose(earned, 1.0) and len(actions) <= step_budget(puzzle.task)


def is_robust(world: World, puzzle: Puzzle, actions: Sequence[int]) -> bool:
    """Whether the actions solve the puzzle without a shift and after each shift of `SHIFTS_M`."""
    shape = len(world.inventory), 3
    rng = np.random.default_rng(0)
    shifts = (size * rng.standard_normal(shape) for size in SHIFTS_M)
    return solves(world, puzzle, actions) and all(solves(world, puzzle, actions, shift) for shift in shifts)


def _search(world: World, puzzle: Puzzle, greed: float) -> Iterator[tuple[tuple[int, ...], int]]:
    """Yield solutions in order of their bounds, each with the number of steps simulated so far."""
    bound = _Bound(puzzle, greed)
    world.load(puzzle)
    moving = np.flatnonzero(world.present)
    goals = {world.inventory[i]: i for i in moving if kind_of(world.inventory[i]) in REWARDS[puzzle.task]}
    places = world.data.qpos.reshape(-1, 7)
    ties = itertools.count()
    queue: list[tuple[float, int, int, _Node, int]] = []
    seen: set[bytes] = set()

    def expand(node: _Node) -> None:
        key = _key(node.agent, places[moving[1:], :3], len(node.goals))
        if key in seen:
            return
        seen.add(key)
        for action in range(1, c.N_ACTIONS):
            least = bound(node, action)
            heapq.heappush(queue, (least, -len(node.actions), next(ties), node, action))

    def here(cost: float, left: Iterable[str], actions: tuple[int, ...]) -> _Node:
        there = {name: places[goals[name], :2].copy() for name in left}
        return _Node(world.save_state(), places[0, :3].copy(), there, cost, actions)

    expand(here(0.0, goals, ()))
    for simulated in range(1, SIMULATIONS + 1):
        if not queue:
            return
        _, _, _, parent, action = heapq.heappop(queue)
        world.restore_state(parent.state)
        outcome = world.step(action)
        verdict = judge(puzzle.task, puzzle, len(goals) - len(parent.goals), outcome)
        left = [name for name in parent.goals if name not in outcome.hits]
        actions = (*parent.actions, action)
        if not left and verdict.reward > 0:
            yield actions, simulated
        elif not verdict.terminated and len(actions) < step_budget(puzzle.task):
            expand(here(parent.cost + verdict.reward * math.log(len(actions)), left, actions))


def _key(agent: np.ndarray, others: np.ndarray, left: int) -> bytes:
    grains = [np.rint(agent / AGENT_GRAIN), np.rint(others / OBJECT_GRAIN).ravel(), [left]]
    return np.concatenate(grains).astype(np.int16).tobytes()


class _Bound:
    """Lower bound of the cost through a node's child, as if only the pen's wall were in the agent's way."""

    def __init__(self, puzzle: Puzzle, greed: float) -> None:
        self.rewards, self.greed = REWARDS[puzzle.task], greed
        self.pen = puzzle.pen and _PenExit(puzzle.pen)

    def __call__(self, node: _Node, action: int) -> float:
        start = node.agent[:2]
        end = start + REACH * np.array(c.MOVES[action])
        if self.pen and self.pen.holds(node.agent) and not self.pen.inside(end):
            end = start
        done = len(node.actions) + 1

        def cost(order: tuple[str, ...]) -> float:
            total, at, moves = node.cost, end, 0
            for i, name in enumerate(order):
                goal = node.goals[name]
                if i or _distance_to_path(start, end, goal) > TOUCH:
                    moves += self._moves(at, goal, node.agent[2])
                total += self.rewards[kind_of(name)] * math.log(done + self.greed * moves)
                at = goal
            return total

        return min(cost(order) for order in itertools.permutations(node.goals))

    def _moves(self, start: np.ndarray, goal: np.ndarray, height: float) -> int:
        if not self.pen or not self.pen.inside(start):
            return least_moves(start, goal)
        way, moves = [self.pen.platform, goal], 0
        if height < self.pen.LOW:
            way.insert(0, self.pen.foot)
        for point in way:
            moves, start = moves + least_moves(start, point), point
        return moves


class _PenExit:
    """The exit of a pen: to the foot of its ramp, up to the platform, over the wall."""

    LOW = c.RADIUS + 0.01
    """An agent below this height is not on the ramp."""

    def __init__(self, pen: Pen) -> None:
        i, j = SIDES[pen.ramp_side]
        self.centre = np.array(c.cell_centre(pen.row, pen.column))
        self.foot = self.centre + c.RAMP_FOOT * np.array([j, -i])
        self.platform = self.centre + (c.PEN_HALF - c.RAMP_PLATFORM / 2) * np.array([j, -i])

    def inside(self, place: np.ndarray) -> bool:
        return bool(np.abs(place - self.centre).max() < c.PEN_HALF)

    def holds(self, agent: np.ndarray) -> bool:
        return self.inside(agent[:2]) and agent[2] < c.WALL_HEIGHT


def least_moves(start: np.ndarray, goal: np.ndarray) -> int:
    """Smallest number of actions until an unhindered agent from `start` touches a resting sphere at `goal`."""
    x, y = np.abs(goal - start)
    moves = 0
    while math.hypot(max(x - moves * REACH, 0.0), max(y - moves * REACH, 0.0)) > TOUCH:
        moves += 1
    return moves


def _distance_to_path(start: np.ndarray, end: np.ndarray, point: np.ndarray) -> float:
    way = end - start
    share = np.clip((point - start) @ way / max(way @ way, 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(start + share * way - point))
