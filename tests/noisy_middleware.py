"""A middleware that prints to standard output: what Fast DDS and the logging of ROS say gets in the way of results."""

from __future__ import annotations

from pathlib import Path

PROFILES = "<profiles><nonsense/></profiles>"
"""A file of profiles that Fast DDS complains about on its standard output, whenever a process starts it."""

COMPLAINT = "nonsense"


def noise(folder: Path) -> dict[str, str]:
    """Environment variables with which both print there; ``folder`` for a file."""
    file = folder / "profiles.xml"
    file.write_text(PROFILES)
    variables = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
    return {**dict.fromkeys(variables, str(file)), "RCUTILS_LOGGING_USE_STDOUT": "1"}
