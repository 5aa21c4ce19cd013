"""Pure learning code: encoders, world models, rewards and PPO. No disk, no environment construction."""
