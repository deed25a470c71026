"""PySyncObj, and all that knows it."""
