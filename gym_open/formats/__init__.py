"""Files that stages exchange: logs (MCAP), releases (LeRobot), models and checkpoints (safetensors)."""
