"""Planning above the simulator: plans of a line, the law that follows them, their verification by rides; no ROS."""
