"""Load cells: calibration, readings to wrenches, and node ``load_cell``."""
