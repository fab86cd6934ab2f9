"""ROS side of node ``force_ctrl``."""
