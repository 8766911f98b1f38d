"""Simulation in control steps: requests, plants, scenes, snapshots, events and batches; imports no ROS."""
