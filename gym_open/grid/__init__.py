"""`gym-open benchmark`: a grid of agents × tasks × seeds from one file, run as parallel jobs."""

from gym_open.grid.config import AgentConfig, GridConfig
from gym_open.grid.runner import run_grid

__all__ = ["AgentConfig", "GridConfig", "run_grid"]
