"""The target, and the surface the tip of a tool may move on, sampled on regular grids."""
