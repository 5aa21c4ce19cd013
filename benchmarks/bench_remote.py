"""Steps per second of the paper's interface, in this process and on a server on this machine.

Run: uv run python benchmarks/bench_remote.py
"""

import re
import statistics
import subprocess
import sys
import time
from typing import Any

import gymnasium
import numpy as np

STEPS, ROUNDS = 1000, 5


def steps_per_s(images: bool, **where: Any) -> float:
    env: Any = gymnasium.make("gym_open:open_puzzle_proc-v0", **where)
    env.add_change_puzzle(1, 1)
    env.set_observation(images)
    env.turn_off_reward(True)
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(1, 9, STEPS).tolist()
    env.step(0)
    began = time.perf_counter()
    for action in actions:
        env.step(action)
    took = time.perf_counter() - began
    env.close()
    return STEPS / took


def main() -> None:
    code = "from gym_open.remote.server import serve; serve(port=0)"
    server = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert server.stdout
    port = int(re.findall(r":(\d+),", server.stdout.readline())[0])
    try:
        for images in (True, False):
            near, far = [], []
            for _ in range(ROUNDS):  # in turns, so that both have the same load
                near.append(steps_per_s(images))
                far.append(steps_per_s(images, env_ip="127.0.0.1", port=port))
            ratio = statistics.median(b / a for a, b in zip(near, far, strict=True))
            what = "with images" if images else "states alone"
            print(f"{what}: {max(near):,.0f} steps/s here, {max(far):,.0f} on the server; ratio {ratio:.2f} (median)")
    finally:
        server.terminate()
        server.wait()


if __name__ == "__main__":
    main()
