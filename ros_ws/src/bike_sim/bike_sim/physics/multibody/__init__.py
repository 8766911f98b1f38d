"""Trees of rigid bodies and joints: as data, compiled, and in PyBullet. Knows no vehicle."""
