"""The handsome look: figures of a world for people, drawn by `mujoco.Renderer`."""
