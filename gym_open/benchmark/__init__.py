"""`gym-open benchmark`: agents × tasks × seeds from one file, as jobs side by side."""

from gym_open.benchmark.config import AgentConfig, BenchmarkConfig
from gym_open.benchmark.runner import run_benchmark

__all__ = ["AgentConfig", "BenchmarkConfig", "run_benchmark"]
