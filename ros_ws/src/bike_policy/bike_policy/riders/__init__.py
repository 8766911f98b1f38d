"""Who answers a snapshot with a command: learned and classical riders; knows no ROS."""
