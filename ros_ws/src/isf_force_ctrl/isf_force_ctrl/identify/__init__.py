"""Identification of the machine with its own tools: probes, fits and the rig file made of them."""
