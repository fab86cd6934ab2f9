"""The CAD surface of a part: read, checked, repaired, placed on the blank."""
