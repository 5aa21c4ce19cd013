"""Stage 3: learn encoders from a release, probe them, and train policies with PPO."""
