"""What `gym-open run` prints before it starts: what this machine has, and how long the run will take on it.

`work.py` counts the work of each stage from its configuration alone. `speed.py` measures what a unit of work costs
here. `outlook.py` prints both.
"""
