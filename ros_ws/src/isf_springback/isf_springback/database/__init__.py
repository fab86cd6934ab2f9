"""Load and displacement of a part, computed before it is formed, and the places they are computed at."""
