"""The ROS 2 face of the package: thin nodes around the core, and what they share."""
