"""Compares our match with the synchronisers of ROS message_filters, on the same recorded inputs."""
