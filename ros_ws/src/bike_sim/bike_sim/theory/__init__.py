"""What a machine could do: its envelope, the theoretical lap, and the fastest line of a circuit; knows no ROS."""
