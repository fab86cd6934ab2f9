"""Closed loops of the tool tip at every level, and the feature each belongs to."""
