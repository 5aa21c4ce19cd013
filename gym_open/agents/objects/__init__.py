"""Objects from exploration: encoders that give places of objects, and the world model that finds the agent."""

from gym_open.agents.objects.model import Objects

__all__ = ["Objects"]
