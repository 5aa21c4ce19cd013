"""The window in which a person plays: Gymnasium's `PlayableGame` with one move per key press.

Gymnasium's own loop, `gymnasium.utils.play.play`, repeats a move in every frame while a key is down, and loses presses
that are shorter than a frame. Here every move counts, so this module has a loop of its own around Gymnasium's window.
"""

import os
import warnings
from collections import deque
from typing import Any

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
with warnings.catch_warnings():
    # Without a window toolkit, Matplotlib is said to be missing; nothing is plotted here, so that does not matter.
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
"""Keys of each move; action 0 has no key, since it lets no time pass."""
_ACTION = {key: action for action, keys in KEYS.items() for key in keys}


class PlayWindow(PlayableGame):
    """A window that shows `env`, which must have been reset, and turns key presses into moves.

    Args:
        env: with `render_mode="rgb_array"`.
        zoom: factor by which the image is enlarged.

    Raises:
        GymOpenError: if there is no screen to open a window on.
    """

    def __init__(self, env: OpenEnv, zoom: float) -> None:
        self._moves: deque[int] = deque()
        self._clock = pygame.time.Clock()
        try:
            pygame.display.init()
            if pygame.display.get_driver() == "offscreen":  # SDL's own choice if there is no screen
                raise pygame.error("there is no screen")
            super().__init__(env, {(key,): action for key, action in _ACTION.items()}, zoom)
        except pygame.error as error:
            pygame.quit()
            raise GymOpenError(
                f"no window can be opened: {error}; play on a machine with a screen, or on a virtual one: "
                "xvfb-run gym-open play …"
            ) from None

    def process_event(self, event: Any) -> None:
        """Turn a key press into one move; Gymnasium handles the rest (closing, Esc, resizing)."""
        if event.type in {pygame.KEYDOWN, pygame.KEYUP} and event.key in _ACTION:
            if event.type == pygame.KEYDOWN:
                self._moves.append(_ACTION[event.key])
        else:
            super().process_event(event)

    def next_move(self, caption: str) -> int | None:
        """Wait for a move; return None if the window is closed or Esc is pressed."""
        while True:
            self._frame(caption)
            if not self.running:
                return None
            if self._moves:
                return self._moves.popleft()

    def pause(self, caption: str, seconds: float) -> None:
        """Show the present state for some seconds; key presses are ignored meanwhile."""
        for _ in range(round(seconds * FRAMES_PER_S)):
            self._frame(caption)
        self._moves.clear()

    def close(self) -> None:
        """Close the window."""
        pygame.quit()

    def _frame(self, caption: str) -> None:
        pygame.display.set_caption(caption)
        image = self.env.render()
        assert isinstance(image, np.ndarray)
        display_arr(self.screen, image, video_size=self.video_size, transpose=True)
        pygame.display.flip()
        for event in pygame.event.get():
            self.process_event(event)
        self._clock.tick(FRAMES_PER_S)
