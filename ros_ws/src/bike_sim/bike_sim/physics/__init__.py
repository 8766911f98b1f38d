"""Vehicles, their kinematics, the engines that move them, and their linear modes; knows no ROS."""
