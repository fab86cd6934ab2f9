"""Shapes that several packages share: height maps, openings, kinematics of tools."""
