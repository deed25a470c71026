"""Finds, lists and changes a running cluster. The command line and a joining supernode use this package."""
