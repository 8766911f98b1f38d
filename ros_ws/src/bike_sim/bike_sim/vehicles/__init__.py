"""Parameters of bicycles and superbikes, and the files that describe them; imports no ROS."""
