mod ros2;
