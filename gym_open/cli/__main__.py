"""`python -m gym_open.cli`."""

import sys

from gym_open.cli import main

sys.exit(main())
