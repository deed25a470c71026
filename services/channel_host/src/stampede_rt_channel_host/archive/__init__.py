"""Archives on disk: the folder of a host, the segments of each channel, and the threads that write and read them."""
