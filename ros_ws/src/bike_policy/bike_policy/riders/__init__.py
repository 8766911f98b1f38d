"""Riders, which answer snapshots with commands: learned, classical and LQR; imports no ROS."""
