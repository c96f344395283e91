"""Message encoding: CDR payloads, and ROS 2 schemas with the numpy layouts derived from them."""
