"""The driver with tools that weigh more than a free tool may read, until a tare; started by test_driver_node.py."""

import numpy as np
from isf_driver_example import driver_node, hardware

WEIGHT = 60.0
"""N, of each tool."""

if __name__ == "__main__":
    hardware.ZEROS = hardware.ZEROS - np.array([0.0, 0.0, WEIGHT])
    driver_node.main()
