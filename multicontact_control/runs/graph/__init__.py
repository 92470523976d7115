"""The ROS graph of a run: its processes, their life cycle, their domain."""
