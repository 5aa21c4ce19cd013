"""The window in which a person plays: Gymnasium's `PlayableGame` with one move a key press.

Gymnasium's own loop, `gymnasium.utils.play.play`, repeats a move in every frame while a key is down and loses presses
that are shorter than a frame; every move counts in a score here, so its window and drawing run in a loop of ours.
"""

import os
import warnings
from collections import deque
from typing import Any

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
with warnings.catch_warnings():
    # It asks Matplotlib for a window toolkit; without one it says that Matplotlib is not installed. Nothing is plotted.
    warnings.filterwarnings("ignore", message=".*matplotlib is not installed")
    from gymnasium.utils.play import PlayableGame, display_arr

import numpy as np
import pygame

from gym_open.envs.env import OpenEnv
from gym_open.errors import GymOpenError

FRAMES_PER_S = 30
KEYS: dict[int, tuple[int, ...]] = {
    1: (pygame.K_d, pygame.K_RIGHT, pygame.K_KP6),
    2: (pygame.K_e, pygame.K_KP9),
    3: (pygame.K_w, pygame.K_UP, pygame.K_KP8),
    4: (pygame.K_q, pygame.K_KP7),
    5: (pygame.K_a, pygame.K_LEFT, pygame.K_KP4),
    6: (pygame.K_z, pygame.K_KP1),
    7: (pygame.K_x, pygame.K_s, pygame.K_DOWN, pygame.K_KP2),
    8: (pygame.K_c, pygame.K_KP3),
}
"""Keys of each move; action 0 has none, since it lets no time pass."""
_ACTION = {key: action for action, keys in KEYS.items() for key in keys}


class Window(PlayableGame):
    """A window that shows `env`, which must have been reset, and turns key presses into moves.

    Args:
        env: with `render_mode="rgb_array"`.
        zoom: how many times a pixel of the picture is enlarged.

    Raises:
        GymOpenError: if there is no screen to open a window on.
    """

    def __init__(self, env: OpenEnv, zoom: float) -> None:
        self._moves: deque[int] = deque()
        self._clock = pygame.time.Clock()
        try:
            pygame.display.init()
            if pygame.display.get_driver() == "offscreen":  # SDL takes it by itself where it finds no screen
                raise pygame.error("there is no screen")
            super().__init__(env, {(key,): action for key, action in _ACTION.items()}, zoom)
        except pygame.error as error:
            pygame.quit()
            raise GymOpenError(
                f"no window can be opened: {error}; play on a machine with a screen, or on a virtual one: "
                "xvfb-run gym-open play …"
            ) from None

    def process_event(self, event: Any) -> None:
        """One press, one move; the rest (closing, Esc, resizing) is Gymnasium's."""
        if event.type in {pygame.KEYDOWN, pygame.KEYUP} and event.key in _ACTION:
            if event.type == pygame.KEYDOWN:
                self._moves.append(_ACTION[event.key])
        else:
            super().process_event(event)

    def next_move(self, caption: str) -> int | None:
        """Wait for a move; None when the window was closed or Esc pressed."""
        while True:
            self._frame(caption)
            if not self.running:
                return None
            if self._moves:
                return self._moves.popleft()

    def pause(self, caption: str, seconds: float) -> None:
        """Show how it stands for a while; moves are not taken meanwhile."""
        for _ in range(round(seconds * FRAMES_PER_S)):
            self._frame(caption)
        self._moves.clear()

    def close(self) -> None:
        """Close the window."""
        pygame.quit()

    def _frame(self, caption: str) -> None:
        pygame.display.set_caption(caption)
        picture = self.env.render()
        assert isinstance(picture, np.ndarray)
        display_arr(self.screen, picture, video_size=self.video_size, transpose=True)
        pygame.display.flip()
        for event in pygame.event.get():
            self.process_event(event)
        self._clock.tick(FRAMES_PER_S)
