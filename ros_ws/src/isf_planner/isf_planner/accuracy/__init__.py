"""Accuracy surfaces: deviation of formed parts by feature and place, and targets moved against it."""
