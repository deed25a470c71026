"""Our match beside the synchroniser of ROS message_filters, on the same recorded inputs."""
