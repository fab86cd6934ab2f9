"""ROS side of node ``machine``."""
