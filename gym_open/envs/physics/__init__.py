"""The physics of a world: MuJoCo model, contacts, meshes, and a step in compiled code."""
