"""The physics held against its publications; knows no ROS."""
