"""Processes of a cell: found, started together, watched and ended with their owner."""
