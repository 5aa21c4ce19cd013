"""What a run says before it starts: what it found on this machine, and how long it will take here.

`work.py` counts what the stages do, from their configurations alone; `speed.py` tries what one of each costs here;
`outlook.py` says both.
"""
