"""What `ros2 topic` and `ros2 bag record` do, for where ros2cli is not installed."""
