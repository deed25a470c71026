"""The log's own thread, the thread beside it, and the way back to the event loop."""
