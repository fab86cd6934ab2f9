"""Toolpath planning for incremental sheet forming: from a CAD surface to contours and tool tips."""
