"""Episode of one agent as Rerun entities below the agent's number; `side_by_side` lists the entities."""

import numpy as np
import rerun as rr

from gym_open.envs import constants as c
from gym_open.envs.physics.model import kind_of
from gym_open.envs.puzzles import Puzzle
from gym_open.formats.pngs import encode_pngs
from gym_open.plots import agent_style, rgb
from gym_open.viz.puzzles.episodes import PuzzleEpisode
from gym_open.viz.streams.table import Trail, log_contacts, log_moves, log_objects, log_scenery, log_styles, log_table
from gym_open.viz.view import YELLOW, tensors, times

_REACH = 0.3
"""Length in metres of the arrow of an action with probability 1."""


def log_agent(
    rec: rr.RecordingStream, puzzle: Puzzle, episode: PuzzleEpisode, number: int, *, longest: int, trail_steps: int
) -> None:
    """Log the whole episode of one agent.

    Args:
        rec: the recording.
        puzzle: the puzzle.
        episode: the agent's episode.
        number: the agent's number, first part of every entity path.
        longest: steps of the longest episode in the view; the return is drawn up to there.
        trail_steps: length of the agent's trail.
    """
    root, moments = f"{number}", np.arange(episode.steps + 1)
    files = encode_pngs(episode.images)
    columns = rr.EncodedImage.columns(blob=files, media_type=["image/png"] * len(files))
    rec.send_columns(f"{root}/observation", times(moments), columns)
    _log_table(rec, f"{root}/table", puzzle, episode, trail_steps)
    _log_touched(rec, f"{root}/table", episode)
    _log_series(rec, root, episode, number, longest)
    _log_policy(rec, root, episode, number)


def _log_series(rec: rr.RecordingStream, root: str, episode: PuzzleEpisode, number: int, longest: int) -> None:
    style = {"names": episode.name, "colors": rgb(agent_style(number)[0])}
    rec.log(f"{root}/return", rr.SeriesLines(**style, widths=2.5), static=True)
    rec.log(f"{root}/action", rr.SeriesPoints(**style, marker_sizes=4), static=True)
    earned, at = episode.returns, np.arange(episode.steps + 1)
    if longest > episode.steps:
        earned, at = np.append(earned, earned[-1]), np.append(at, longest)
    rec.send_columns(f"{root}/return", times(at), rr.Scalars.columns(scalars=earned))
    acting = times(np.arange(episode.steps))
    rec.send_columns(f"{root}/action", acting, rr.Scalars.columns(scalars=episode.actions))


def _log_policy(rec: rr.RecordingStream, root: str, episode: PuzzleEpisode, number: int) -> None:
    """Log value and entropy as series, and action probabilities as bars and as arrows around the agent."""
    if episode.policy is None:
        return
    policy, acting = episode.policy, times(np.arange(episode.steps))
    for name, values in (("value", policy.values), ("entropy", policy.entropy)):
        line = rr.SeriesLines(names=episode.name, colors=rgb(agent_style(number)[0]), widths=2)
        rec.log(f"{root}/policy/{name}", line, static=True)
        rec.send_columns(f"{root}/policy/{name}", acting, rr.Scalars.columns(scalars=values))
    bars = [rr.BarChart(row) for row in policy.probabilities]
    rec.send_columns(f"{root}/policy/probabilities", acting, tensors(bars))
    _, hue = rr.BarChart(policy.probabilities[0], color=rgb(agent_style(number)[0])).as_component_batches()
    rec.send_columns(f"{root}/policy/probabilities", times([0]), [rr.ComponentColumn(hue.component_descriptor(), hue)])
    moves = np.pad(np.array(c.MOVES[1:], np.float32), ((0, 0), (0, 1)))
    agent = episode.states[:-1, episode.objects.index("agent"), :3].astype(np.float32)
    vectors = _REACH * policy.probabilities[:, 1:, None].astype(np.float32) * moves
    taken = np.array(episode.actions)[:, None] == np.arange(1, c.N_ACTIONS)
    arrows = rr.Arrows3D.columns(
        origins=np.repeat(agent, len(moves), axis=0),
        vectors=vectors.reshape(-1, 3),
        colors=np.where(taken[..., None], YELLOW, (255, 255, 255)).astype(np.uint8).reshape(-1, 3),
    )
    rec.log(f"{root}/table/policy", rr.Arrows3D.from_fields(radii=0.007), static=True)
    rec.send_columns(f"{root}/table/policy", acting, arrows.partition([len(moves)] * episode.steps))


def _log_table(rec: rr.RecordingStream, entity: str, puzzle: Puzzle, episode: PuzzleEpisode, trail_steps: int) -> None:
    moments = np.arange(episode.steps + 1)
    log_table(rec, entity)
    log_scenery(rec, entity, puzzle, times([0]))
    log_styles(rec, entity)
    log_objects(rec, entity, episode.objects, episode.states, moments, begins=True)
    agent = episode.states[:, episode.objects.index("agent"), :3]
    Trail(trail_steps).log(rec, entity, agent, 0, moments, begins=True)
    log_moves(rec, entity, agent[:-1], np.array(episode.actions), moments[:-1])
    log_contacts(rec, entity, episode.contacts, moments[:-1])


def _log_touched(rec: rr.RecordingStream, entity: str, episode: PuzzleEpisode) -> None:
    """Log the goals in their hit colour from the touch on, as the agent sees them."""
    hit: set[str] = set()
    for step, names in enumerate(episode.touched, 1):
        hit |= set(names)
        for kind in {kind_of(name) for name in names}:
            there = [name for name in episode.present if kind_of(name) == kind]
            colours = [c.HIT_COLOUR[kind] if name in hit else c.COLOUR[kind] for name in there]
            rec.send_columns(
                f"{entity}/{kind}", times([step]), rr.Ellipsoids3D.columns(colors=colours).partition([len(there)])
            )
