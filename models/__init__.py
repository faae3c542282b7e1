"""Robots, worlds and scenarios. `MODELS_DIR` is the folder that `package://naraha/` points to."""

from pathlib import Path

MODELS_DIR = Path(__file__).parent
