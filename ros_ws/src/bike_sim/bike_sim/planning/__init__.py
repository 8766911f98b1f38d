"""Planning below the simulator: envelope of a machine, theoretical lap, fastest line of a circuit; knows no ROS."""
