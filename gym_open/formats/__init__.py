"""What the stages exchange on disk: logs (MCAP), releases (LeRobot), models and checkpoints (safetensors)."""
