"""`stampede bench`: measures Stampede RT and comparable systems, as tables and charts."""
