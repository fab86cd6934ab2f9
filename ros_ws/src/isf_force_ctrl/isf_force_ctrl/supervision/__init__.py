"""Watch over wrenches, forces and the timing of ticks."""
