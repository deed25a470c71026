"""What the command line and a supernode that joins both do with a running cluster: find it, list it, change it."""
