"""The machine: axes, load cells, events, one compiled tick, and its saved state."""
