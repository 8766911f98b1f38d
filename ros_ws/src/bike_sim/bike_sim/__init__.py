"""A bicycle on a course: physics, courses, the simulator, and its ROS 2 nodes."""
