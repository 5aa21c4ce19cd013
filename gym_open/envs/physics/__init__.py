"""The table as MuJoCo moves it: model, contacts, meshes, and a step in compiled code."""
