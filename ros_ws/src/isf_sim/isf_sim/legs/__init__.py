"""Six hydraulic legs that move a platform: fuzzy or linear position loops, valves, cylinders, pump, encoders."""
