"""The table as it is seen: ray caster for agents, MuJoCo's renderer for people."""
