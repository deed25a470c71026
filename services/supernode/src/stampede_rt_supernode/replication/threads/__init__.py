"""The log's own thread, a thread for long work, and the way back to the event loop."""
