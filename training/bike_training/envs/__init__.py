"""Simulators in process and behind ROS, and the environments on top of them."""
