"""Springback correction of every contour before it is formed: sheet models and force forecast."""
