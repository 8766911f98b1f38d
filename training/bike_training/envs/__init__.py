"""Simulators in process and behind ROS, and the environments on top of them.

Importing this package registers its ids in Gymnasium.
"""

from bike_training.envs.registration import register

register()
