"""Measurements made by the tools between contours."""
