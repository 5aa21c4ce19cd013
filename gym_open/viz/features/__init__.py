"""An encoder in Rerun: its features of some images in two and three dimensions, linked to the images themselves."""

from gym_open.viz.features.page import view

__all__ = ["view"]
