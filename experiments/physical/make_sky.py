"""Writes `data/sky.exr`, the evening sky around the scenes of glass: made up, not photographed.

    python experiments/physical/make_sky.py data/sky.exr

Equirectangular, 256 x 128 texels, linear: a gradient over dark ground, the glow where the sun has set, two windows.
"""

import sys

import numpy as np

from raytrace_jax import write_exr

WIDTH, HEIGHT = 256, 128
ZENITH, HORIZON, GROUND = (0.10, 0.17, 0.36), (0.62, 0.55, 0.50), (0.05, 0.05, 0.06)
GLOW, LAMP = (3.2, 1.5, 0.55), (7.0, 6.6, 6.0)


def smooth(x):
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def window(across, up, left, right, low, high):
    """1 within a soft-edged window with a cross of bars."""
    soft = 0.02
    inside = smooth((across - left) / soft) * smooth((right - across) / soft)
    inside *= smooth((up - low) / soft) * smooth((high - up) / soft)
    bars = smooth(abs(across - (left + right) / 2) / soft - 0.5) * smooth(abs(up - (low + high) / 2) / soft - 0.5)
    return inside * bars


def sky():
    across, down = np.meshgrid((np.arange(WIDTH) + 0.5) / WIDTH, (np.arange(HEIGHT) + 0.5) / HEIGHT)
    across, up = 2 * np.pi * (across - 0.5), np.pi * (0.5 - down)  # 0 is along -z, to the right +x.

    def column(color):
        return np.array(color)[:, None, None]

    height = smooth(up / 1.2)
    above = column(HORIZON) * (1 - height) + column(ZENITH) * height
    ground = column(GROUND) * (1 + 0.5 * smooth(-up / 1.5))
    picture = ground + (above - ground) * smooth((up + 0.03) / 0.06)
    glow = np.exp(-(((across - 0.9) / 0.55) ** 2) - ((up - 0.02) / 0.16) ** 2) * smooth((up + 0.03) / 0.06)
    picture += column(GLOW) * glow
    lit = window(across, up, -2.7, -2.1, 0.45, 1.0) + window(across, up, 2.35, 2.75, 0.35, 0.8)
    return picture + column(LAMP) * lit


if __name__ == "__main__":
    write_exr(sys.argv[1], sky(), half=True)  # As other renderers read it.
