"""A vehicle in its surroundings, in control steps: requests, scenes, snapshots, events and batches; knows no ROS."""
