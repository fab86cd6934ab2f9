"""Process model of incremental sheet forming shared by all packages; free of ROS.

Units are SI (m, N, Pa, rad, s) and positions are in the frame ``sheet`` (origin at
the centre of the clamped blank on its upper surface, z up) unless a docstring says
otherwise.
"""

__version__ = "0.1.0"
