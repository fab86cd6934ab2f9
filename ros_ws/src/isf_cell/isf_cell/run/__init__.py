"""Forming one part: its sequence, the cell it runs on (in process or the node graph), and runs that measure."""
