"""Courses: lines to follow, from elements, files or chance, with projection and preview. Knows no ROS."""
