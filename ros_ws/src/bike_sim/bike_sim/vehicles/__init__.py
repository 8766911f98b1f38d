"""What a machine is: bicycles, superbikes, and the files that describe them; knows no ROS."""
