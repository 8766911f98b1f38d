"""Bumps of a road: random profiles of height with the spectrum of ISO 8608, by seed.

ISO 8608:2016, Mechanical vibration - Road surface profiles - Reporting of measured data: the one-sided power spectral
density of the height is ``G(n) = G0 (n / 0.1)^-2`` over the spatial frequency n, cycles per m, and classes A to H have
the geometric means ``G0 = 16e-6 m3`` times 4 from class to class (Annex C).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

REFERENCE: Final = 16e-6
"""Density of class A at 0.1 cycles per m, m3."""
CLASSES: Final = {name: REFERENCE * 4.0**k for k, name in enumerate("ABCDEFGH")}
"""Geometric mean of the density at 0.1 cycles per m by class, m3."""

_BAND: Final = (0.011, 2.83)
"""Spatial frequencies that the standard covers, cycles per m."""
_AT: Final = 0.1


def bump_profile(seed: int, samples: int, spacing: float) -> NDArray[np.float64]:
    """Return heights of a periodic profile of class A, m, shape (samples,); read-only.

    Each frequency has the amplitude of the spectrum and a random phase.

    Args:
        seed: same seed, same road.
        samples: number of heights.
        spacing: distance between them, m.
    """
    frequency = np.fft.rfftfreq(samples, spacing)
    within = (frequency >= _BAND[0]) & (frequency <= _BAND[1])
    amplitude = np.zeros(len(frequency))
    amplitude[within] = np.sqrt(2.0 * REFERENCE * (frequency[within] / _AT) ** -2.0 * frequency[1])
    phase = 2.0 * np.pi * np.random.default_rng(seed).random(len(frequency))
    profile = np.fft.irfft(0.5 * samples * amplitude * np.exp(1j * phase), samples)
    profile.setflags(write=False)
    return profile
