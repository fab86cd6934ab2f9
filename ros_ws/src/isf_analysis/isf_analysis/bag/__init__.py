"""Bags: the topics of a cell written to MCAP and read back, without ROS."""
