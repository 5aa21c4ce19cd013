"""The observation: a ray caster that draws a world from its compiled model."""
