"""The bicycle paper: Weyrer et al. (2026)."""
