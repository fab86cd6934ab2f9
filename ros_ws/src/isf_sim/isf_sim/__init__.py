"""Simulated two-tool forming machine: sheet, contact, servo axes and load cells."""
