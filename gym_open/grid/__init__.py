"""`gym-open benchmark`: agents × tasks × seeds from one file, as jobs side by side."""

from gym_open.grid.config import AgentConfig, GridConfig
from gym_open.grid.runner import run_grid

__all__ = ["AgentConfig", "GridConfig", "run_grid"]
