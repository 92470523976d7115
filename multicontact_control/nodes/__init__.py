"""The ROS 2 face of the package: thin nodes around the core, and what they share."""

from multicontact_control.process import limit_threads

limit_threads()  # every node's process comes through here before it imports numpy
