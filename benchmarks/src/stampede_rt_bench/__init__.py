"""`stampede bench`: figures with their peers beside them, as tables and charts."""
