"""State, kinematics, tyres, forces, the engines that move vehicles, and their linear modes; knows no ROS."""
